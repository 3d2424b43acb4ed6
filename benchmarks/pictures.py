"""Pictures of every page, in both themes, on a service that holds what a laboratory's would.

``python benchmarks/pictures.py [FOLDER]`` writes them (``docs/page`` by itself); with ``--tablet`` every page is also
shown at 1024 × 768, with ``--wide`` at 1440 × 900. It needs Debian's chromium and playwright, and takes about ten
minutes.
"""

import argparse
import re
import tempfile
import time
from pathlib import Path

import numpy as np

from fabry_perot.simulator.named_phantoms import vessels
from fabry_perot.simulator.phantoms import pressure
from page import service_and_browser
from page_camera import Camera
from steradian_client import Client

APERTURE, SPEED, INTERVAL = 13.56e-3, 1500.0, 16e-9
DEPTHS = (0.5e-3, 7e-3)
WAVELENGTHS = (600e-9, 900e-9)


def recording(folder):
    """Write somebody else's recording of vessels, and where its sensors were, in mm."""
    x = (np.arange(48) - 23.5) * 0.25e-3
    places = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    traces = pressure(vessels(), places, 20e-9 * np.arange(512), SPEED)
    files = [folder / "forearm.npy", folder / "positions.csv"]
    np.save(files[0], np.round(2e4 * traces / np.abs(traces).max()).astype(np.int16))
    np.savetxt(files[1], 1e3 * places, fmt="%.4f", delimiter=",", header="x,y", comments="")
    return files


def scanned(client, sample, *, rate, wait=True, **plan):
    """Run a scan whose image is followed; returns it at once or when it is over."""
    mask = client.masks.equi_steradian(aperture=APERTURE, depth=3.6e-3, count=1600)
    made = client.plans.create(mask.id, pulse_rate=rate, **plan)
    scan = client.scans.create(made.id, labels={"sample": sample, "operator": "L. Berg"})
    live = client.reconstructions.create(scan.id, follow=True, interval=1)
    if wait:
        client.scans.wait(scan)
        client.reconstructions.wait(live)
    return scan


def made(client, scan):
    """Reconstruct a scan in several ways; returns the jobs, the best first, two of them compared."""
    ways = ({}, {"method": "nearest"}, {"sound_speed": SPEED + 40})
    jobs = [client.reconstructions.create(scan.id, depth_range=DEPTHS, **way) for way in ways]
    jobs = [client.reconstructions.wait(job) for job in jobs]
    client.reconstructions.compare(jobs[0].id, jobs[1].id)
    speeds = {"first": SPEED - 60, "last": SPEED + 60, "steps": 21}
    client.jobs.wait(client.jobs.create("sound-speed", scan_id=scan.id, parameters={"modes": 128}, **speeds))
    return jobs


def worked_out(page):
    """Wait until all is worked out."""
    page.wait_for_selector(".picture canvas")


def all_drawn(page):
    """Wait until every picture of the gallery that is in sight has come: before, it is one pixel wide."""
    page.wait_for_function(
        """() => { const all = [...document.querySelectorAll(".gallery canvas")];
          const seen = all.filter((one) => one.getBoundingClientRect().top < innerHeight);
          return seen.length > 0 && seen.every((one) => one.width > 1); }"""
    )


def take_design(camera):
    """A design, its pulse budget, and one that is refused."""
    address = "/design?label=mouse+ear&pulse_rate=400"

    def budget(page):
        worked_out(page)
        panel = page.get_by_role("region", name="Pulse budget")
        for label, value in {"Time (min)": "0.2", "Signal-to-noise of one pulse (dB)": "25"}.items():
            panel.get_by_label(label).fill(value)
        panel.get_by_role("button", name="Propose").click()
        panel.get_by_text("; proposed").wait_for()
        panel.scroll_into_view_if_needed()

    def refused(page):
        worked_out(page)
        page.locator("#field-depth").fill("0")
        page.locator("#design[data-outcome='refused']").wait_for()
        page.locator("#field-depth").scroll_into_view_if_needed()

    camera.take("design", address, "#scan-this:enabled", act=worked_out)
    camera.take("design-budget", address, "#scan-this:enabled", act=budget)
    camera.take("design-refused", address, "#scan-this:enabled", act=refused)


def line_across(volume):
    """A view's fragment: the slice through the brightest voxel, and a line of 2 mm along x through it."""
    x, y, z = (
        1e3 * line[n]
        for line, n in zip(
            (volume.x, volume.y, volume.z), np.unravel_index(volume.values.argmax(), volume.values.shape), strict=True
        )
    )
    return f"#at={x:.3f},{y:.3f},{z:.3f}&slab=0,0,0&tool=line&line=z,{x - 1:.3f},{y:.3f},{x + 1:.3f},{y:.3f}"


def take_volumes(camera, client, jobs):
    """What belongs to a reconstruction that has succeeded."""
    first, second, third = (job.id for job in jobs)
    drawn = "#volume[data-surveyed]"

    def tab(name):
        return lambda page: page.click(f"[data-tab='{name}']")

    def measure_line(page):
        tab("Measure")(page)
        page.wait_for_load_state("networkidle")
        if not page.locator("[data-measurement]").count():  # the first picture of two
            page.get_by_role("button", name="Measure the line").click()
        page.click("[data-measurement] [data-cell='kind']")
        page.wait_for_selector("[data-result='profile']")

    def figure(page):
        page.click("[data-to-figure]")
        page.get_by_role("button", name="Create the figure").scroll_into_view_if_needed()

    camera.take("volumes", "/volumes", ".gallery canvas", act=all_drawn)
    camera.take("volume", f"/volumes/{first}", drawn)
    camera.take(
        "volume-measure",
        f"/volumes/{first}{line_across(client.reconstructions.volume(first))}",
        drawn,
        act=measure_line,
    )
    camera.take("volume-compare", f"/volumes/{first}#against={second}", drawn, act=tab("Compare"))
    camera.take("volume-speed", f"/volumes/{first}#map=depth", drawn, act=tab("Speed"))
    camera.take("volume-files", f"/volumes/{first}", drawn, act=tab("Files"))
    camera.take("volume-figure", f"/volumes/{first}", drawn, act=figure)
    camera.take("volume-enlarged", f"/volumes/{first}#large=z", drawn)
    camera.take("side-by-side", f"/reconstructions?side={first},{third}", "[data-changes]")
    camera.take("reconstruction", f"/reconstructions/{first}", "#reconstruction h2")


def take_series(camera, client):
    """A series of two wavelengths, and one laid over the other."""
    mask = client.masks.equi_steradian(aperture=APERTURE, depth=3.6e-3, count=1600)
    plan = client.plans.create(mask.id, pulse_rate=400.0, excitation=WAVELENGTHS)
    scan = client.scans.create(plan.id, labels={"sample": "mouse ear, two wavelengths"})
    client.scans.wait(scan)
    job = client.reconstructions.wait(client.reconstructions.create(scan.id, depth_range=DEPTHS))

    def compare(page):
        page.click("[data-tab='Compare']")
        page.wait_for_selector("[data-overlay] h3")

    drawn = "#volume[data-surveyed]"
    camera.take("volume-series", f"/volumes/{job.id}#index=1", drawn)
    camera.take("volume-overlay", f"/volumes/{job.id}#map=red&against={job.id}:1&how=overlay", drawn, act=compare)


def take_queue(camera, client, scan, jobs):
    """The queue while one runs and two wait, and the form."""
    long = client.reconstructions.create(scan.id, method="iterative", modes=640, priority=5)
    waiting = [client.reconstructions.create(scan.id, modes=modes) for modes in (300, 400)]
    try:
        camera.take("reconstructions", "/reconstructions", f"[data-row='{long.id}'][data-state='running']")
    finally:
        for job in (*waiting, long):
            if not client.jobs.get(job.id).is_over:
                client.jobs.cancel(job.id)
    camera.take("reconstruction-form", f"/reconstructions?again={jobs[0].id}", "[data-field='modes']")


def take_data(camera, files):
    """A recording that is dropped, before and after it is understood."""

    def drop(page):
        page.set_input_files("#files", files)
        page.wait_for_selector("dl.figures div")

    def bring(page):
        drop(page)
        for name, value in (("Sampling interval", 20), ("Aperture", 12), ("Speed of sound", SPEED)):
            page.get_by_label(name, exact=True).fill(str(value))
        page.get_by_role("button", name="Import").click()
        page.wait_for_selector(".chart canvas")
        page.get_by_text("Imported as").wait_for()
        page.evaluate("scrollTo(0, 0)")

    camera.take("data", "/data", "#files", act=drop)
    camera.take("data-understood", "/data", "#files", act=bring)


def take_choice(camera, client):
    """A scan in stages that waits for the choice of a point of interest."""
    mask = client.masks.equi_steradian(aperture=APERTURE, depth=3.6e-3, count=1600)
    survey = {"points": 400, "choice": "several", "count": 3, "decision": "ask"}
    plan = client.plans.create(mask.id, pulse_rate=400.0, survey=survey)
    scan = client.scans.create(plan.id, labels={"sample": "mouse ear"})
    client.reconstructions.create(scan.id, follow=True, interval=1)

    def waits():
        while client.scans.get(scan.id).stages[1]["state"] == "planned":
            time.sleep(0.5)
        assert client.scans.get(scan.id).state == "paused", "no picture of a scan that waits"

    def shown(page):
        page.wait_for_selector(".stage-choice:visible")
        page.get_by_text("from 400 of 400 A-lines").wait_for()

    waits()
    camera.take("scan-choice", f"/scans/{scan.id}", ".live-frame canvas", act=shown, during=waits)
    client.scans.stop(scan.id)
    client.scans.wait(scan)


def take_running(camera, client):
    """A scan under way, which lasts more than ten minutes, and its emergency stop, pressed while it fires."""
    scan = scanned(client, "mouse ear, second try", rate=2.0, wait=False)
    while client.scans.get(scan.id).progress.done < 200:
        time.sleep(0.5)

    def runs():
        state = client.scans.get(scan.id).state
        assert state == "running", f"the scan is {state}: no picture of one that runs"

    def followed(page):
        page.get_by_text("Newest, point").wait_for()
        page.wait_for_selector("#scanner .laser")

    camera.take("scan", f"/scans/{scan.id}", "section.image canvas", act=followed, during=runs)
    camera.take("scans", "/scans", "tbody tr", act=lambda page: page.wait_for_selector("#scanner .laser"), during=runs)
    runs()
    stop = client.scanners.emergency_stop("a cable was loose")
    assert stop.laser == "off", f"the stop is {stop.laser}: no picture of one that is confirmed"
    while not client.scans.get(scan.id).is_over:
        time.sleep(0.5)
    confirmed = "#stopped:has-text('laser off (confirmed by the device')"
    camera.take("stop", f"/scans/{scan.id}", confirmed, act=lambda page: page.wait_for_selector("section.image canvas"))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parents[1] / "docs" / "page")
    parser.add_argument("--tablet", action="store_true", help="every page at 1024 × 768, too")
    parser.add_argument("--wide", action="store_true", help="every page at 1440 × 900, too")
    parser.add_argument("--only", default="", help="names of pictures that are taken, a regular expression")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    with (
        service_and_browser(phantom="vessels") as (service, _, browser),
        tempfile.TemporaryDirectory(prefix="steradian-pictures-") as folder,
        Client(re.sub("/api/v1$", "", service.url)) as client,
    ):
        sizes = {prefix for prefix, wanted in (("tablet-", asked.tablet), ("wide-", asked.wide)) if wanted}
        camera = Camera(service, browser, asked.folder, sizes=sizes, only=asked.only)
        take_design(camera)
        scan = scanned(client, "mouse ear", rate=400.0)
        camera.take("scan-finished", f"/scans/{scan.id}", "section.image canvas")
        jobs = made(client, scan)
        take_volumes(camera, client, jobs)
        take_series(camera, client)
        take_queue(camera, client, scan, jobs)
        take_data(camera, recording(Path(folder)))
        take_choice(camera, client)
        take_running(camera, client)


if __name__ == "__main__":
    main()
