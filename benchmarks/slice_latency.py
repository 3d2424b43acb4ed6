"""How long a slice of a 226² × 1024 volume takes on the page, from wish to picture, while a reconstruction runs.

    python benchmarks/slice_latency.py http://127.0.0.1:8000

Needs a running service, ``steradian-client``, Playwright and a Chromium. It imports a recording, reconstructs it twice
(the second time iteratively, which takes minutes) and cancels the second one when it has measured.
"""

from __future__ import annotations

import shutil
import sys

import numpy as np
from playwright.sync_api import sync_playwright

from steradian_client import Client

MODES, SAMPLES, POINTS, APERTURE, SPEED, INTERVAL = 226, 1024, 1605, 13.56e-3, 1500.0, 16e-9
TIMES = 60
ARGUMENTS = "--no-sandbox --disable-gpu --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader".split()
WATCH = 'document.addEventListener("steradian:volume", (event) => (window.shown = event.detail));'
STEP = """async ([axis, index]) => {
    const {stage, views, store} = window.shown;
    const view = views.find((one) => one.axis === axis), n = "xyz".indexOf(axis);
    const place = [...stage.position];
    place[n] = stage.source.origin[n] + index * stage.source.spacing[n];
    const drawn = new Promise((go) => {
        const told = () => { if (view.range.from === index) { view.listeners.delete(told); go(performance.now()); } };
        view.listeners.add(told);
    });
    const asked = performance.now();
    store.change({at: place});
    return (await drawn) - asked;
}"""


def recording() -> tuple[np.ndarray, np.ndarray]:
    """Noise at random points: what it shows does not matter."""
    random = np.random.default_rng(0)
    positions = random.uniform(-APERTURE / 2, APERTURE / 2, (POINTS, 2))
    return random.normal(size=(POINTS, SAMPLES)).astype(np.float32), positions


def main(url: str) -> None:
    """Measure, and print the percentiles of each view."""
    traces, positions = recording()
    with Client(url) as client, sync_playwright() as playwright:
        scan = client.imports.import_arrays(traces, positions, sampling_interval=INTERVAL, sound_speed=SPEED)
        made = client.reconstructions.wait(client.reconstructions.create(scan.id, modes=MODES, weights="uniform"))
        print("volume", made.report["shape"])
        busy = client.reconstructions.create(scan.id, modes=MODES, weights="uniform", method="iterative", priority=0)
        while client.reconstructions.get(busy.id).state == "queued":
            pass
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.add_init_script(WATCH)
        page.goto(f"{url}/volumes/{made.id}#slab=0,0,0")
        page.wait_for_function(
            "() => window.shown && [...document.querySelectorAll('.message')].every((one) => one.hidden)"
        )
        random = np.random.default_rng(1)
        for axis, size in zip("xyz", (MODES, MODES, SAMPLES), strict=True):
            places = random.choice(np.arange(1, size - 1), TIMES, replace=False).tolist()
            times = [page.evaluate(STEP, [axis, index]) for index in places]
            figures = ", ".join(f"p{share} {np.percentile(times, share):.0f} ms" for share in (50, 95, 100))
            print(f"across {axis}: {figures}; reconstruction {client.reconstructions.get(busy.id).state}", flush=True)
        browser.close()
        client.jobs.cancel(busy.id)


if __name__ == "__main__":
    main(sys.argv[1])
