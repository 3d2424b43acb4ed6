"""The page in figures: first paint, stop, the thread it holds and the memory it takes while a scan runs.

``python benchmarks/page.py [--presses 25] [--minutes 1]`` prints them as JSON. It needs Debian's chromium and
playwright, wants a quiet machine, and asserts nothing.
"""

import argparse
import json
import math
import shutil
import statistics
import tempfile
import time
from contextlib import contextmanager, nullcontext
from datetime import datetime
from pathlib import Path

from playwright.sync_api import sync_playwright

from fabry_perot.simulator import launch
from steradian.core.settings import Settings
from steradian_benchmarks.service import running_service
from steradian_benchmarks.stop_latency import _cpu_load, _read_simulator, _release, _start, _until

ARGUMENTS = "--no-sandbox --disable-gpu --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader".split()
OVER = {"aborted", "interrupted", "complete", "failed"}
PAGES = ("/design", "/scans", "/scans/{scan}", "/reconstructions", "/volumes", "/volumes/{volume}", "/data")
LOADS = 10
EQUI = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 1600}
EVERY = 10.0
"""Seconds between two looks at the memory."""
PAINT = """() => new Promise((go) => new PerformanceObserver((list) => {
  for (const one of list.getEntriesByName("first-contentful-paint")) go(one.startTime);
}).observe({ type: "paint", buffered: true }))"""
WATCH = """window.tasks = []; new PerformanceObserver((list) => window.tasks.push(...list.getEntries().map(
  (one) => Math.round(one.duration)))).observe({ type: "longtask", buffered: true });"""


@contextmanager
def service_and_browser(**simulator):
    """A service on a simulated scanner of real speed, and a browser."""
    with (
        tempfile.TemporaryDirectory(prefix="steradian-page-") as folder,
        launch(tcp="127.0.0.1:0", **simulator) as scanner,
        running_service(Settings.create(data=Path(folder), port=0, workers=1, scanner=scanner.url)) as service,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        yield service, scanner, browser
        browser.close()


CLICKED = """window.clicked = 0; document.addEventListener("click",
  (event) => (window.clicked = Date.now() - (performance.now() - event.timeStamp)), { capture: true });"""
"""By the machine's clock, which the page's own, begun when it was opened, leaves over minutes."""


def ahead(scanner):
    """Seconds by which the scanner's clock is ahead of this machine's, by the quickest of some answers.

    It never grows: where the simulator gets no processor its clock waits, and no shot is left out.
    """
    found = []
    for _ in range(9):
        asked = time.time()
        told = _read_simulator(scanner)["time"] / 1e6
        answered = time.time()
        found.append((answered - asked, told - (asked + answered) / 2))
    return min(found)[1]


def address(service, path):
    """Where a page of a service is."""
    return service.url.removesuffix("/api/v1") + path


def scan_of(service, key, **plan):
    """Begin a scan of 1,605 points; returns its identifier."""
    mask = service.request("/masks", EQUI)
    made = service.request("/plans", {"mask_id": mask["id"], **plan})
    return service.request("/scans", {"plan_id": made["id"]}, **{"Idempotency-Key": key})["id"]


def paints(service, browser):
    """For each page, in a browser that has kept nothing: median and maximum of the ms to the first contentful paint."""
    scan = scan_of(service, "page-paints", pulse_rate=1000.0)
    _until(lambda: service.request(f"/scans/{scan}")["state"] in OVER)
    made = service.request("/reconstructions", {"scan_id": scan}, **{"Idempotency-Key": "page-paints"})
    _until(lambda: service.request(f"/reconstructions/{made['id']}")["state"] == "succeeded")
    found = {}
    for path in PAGES:
        took = []
        for _ in range(LOADS):
            page = browser.new_context(viewport={"width": 1280, "height": 720}).new_page()
            page.goto(address(service, path.format(scan=scan, volume=made["id"])))
            took.append(page.evaluate(PAINT))
            page.context.close()
        found[path] = {"loads": LOADS, "p50_ms": round(statistics.median(took)), "max_ms": round(max(took))}
    return found


def memory(service, browser, minutes):
    """Heap (MB), elements and listeners of a page that shows a scan at 50 Hz, after its garbage was collected."""
    frames = math.ceil(minutes * 60 * 50 / 1605) + 1
    scan = scan_of(service, "page-memory", pulse_rate=50.0, frames=frames, samples=512)
    service.request(
        "/reconstructions", {"scan_id": scan, "follow": True, "interval": 5}, **{"Idempotency-Key": "memory"}
    )
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    page.goto(address(service, f"/scans/{scan}"))
    inside = page.context.new_cdp_session(page)
    inside.send("Performance.enable")
    found = []
    while len(found) * EVERY < 60 * minutes:
        page.wait_for_timeout(1000 * EVERY)
        inside.send("HeapProfiler.collectGarbage")
        told = {one["name"]: one["value"] for one in inside.send("Performance.getMetrics")["metrics"]}
        found.append([round(told["JSHeapUsedSize"] / 1e6, 2), told["Nodes"], told["JSEventListeners"]])
    page.close()
    heap, nodes, listeners = (list(one) for one in zip(*found, strict=True))
    stored = service.request(f"/scans/{scan}/coverage")["stored"]
    return {"every_s": EVERY, "a_lines": stored, "heap_mb": heap, "nodes": nodes, "listeners": listeners}


def press(service, scanner, page, under):
    """Click the stop during a scan; returns the ms from the click to the API, the scanner's word and the last shot.

    They are counted from the browser's own time of the click: what drives the browser is slow on a busy machine, too.
    The last shot is told from the scanner's clock by comparing it with this machine's afterwards; by how much it had
    waited since just before the click is told besides, and the shot may have been so much earlier.
    """
    scan = _start(service, scanner)
    with under():
        before = ahead(scanner)
        page.locator("#stop").click()
        page.get_by_text("laser off (confirmed").wait_for(timeout=60_000)
        last, after = _read_simulator(scanner)["last_shot"] / 1e6, ahead(scanner)
    clicked = page.evaluate("window.clicked") / 1e3
    stop = service.request("/scanners/scanner-0")["emergency_stop"]
    _until(lambda: service.request(f"/scans/{scan}")["state"] in OVER)
    _release(service)
    page.locator("#stopped").wait_for(state="hidden", timeout=60_000)
    pressed = datetime.fromisoformat(stop["at"]).timestamp()
    steps = {
        "api": pressed - clicked,
        "confirmed": pressed + stop["seconds"] - clicked,
        "last_shot": last - after - clicked,
        "clock_waited": before - after,
    }
    return {name: 1e3 * seconds for name, seconds in steps.items()}


def presses(service, scanner, browser, number):
    """Under each condition: median, 99th percentile and maximum of the ms from the click to each step."""
    found = {}
    for name, under, cut in (
        ("idle", nullcontext, False),
        ("two busy processes", _cpu_load, False),
        ("two busy processes, event stream cut", _cpu_load, True),
    ):
        page = browser.new_page()
        page.add_init_script(CLICKED)
        if cut:
            page.route("**/api/v1/events*", lambda route: route.abort())
        page.goto(address(service, "/data"))
        took = [press(service, scanner, page, under) for _ in range(number)]
        found[name] = {"presses": number} | {step: quantiles([one[step] for one in took]) for step in took[0]}
        page.close()
    return found


def quantiles(took):
    """Of some times: median, 99th percentile (of fewer than 100 the maximum) and maximum, in ms."""
    took = sorted(round(one, 1) for one in took)
    return {"p50_ms": statistics.median(took), "p99_ms": took[math.ceil(0.99 * len(took)) - 1], "max_ms": took[-1]}


def tasks(service, browser):
    """Durations in ms of the long tasks (over 50) of a page that shows a scan of 1,605 points at 1 kHz, ten frames."""
    scan = scan_of(service, "page-tasks", pulse_rate=1000.0, frames=10)
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    page.add_init_script(WATCH)
    page.goto(address(service, f"/scans/{scan}"))
    _until(lambda: service.request(f"/scans/{scan}")["state"] in OVER)
    page.wait_for_timeout(2000)
    found = page.evaluate("window.tasks")
    page.close()
    return {"a_lines": service.request(f"/scans/{scan}/coverage")["stored"], "long_tasks_ms": sorted(found)}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--presses", type=int, default=25, help="of the stop, under each of three conditions")
    parser.add_argument("--minutes", type=float, default=1.0, help="for which the memory is watched")
    asked = parser.parse_args()
    with service_and_browser() as (service, scanner, browser):
        found = {
            "first_paint": paints(service, browser),
            "scan": tasks(service, browser),
            "stop": presses(service, scanner, browser, asked.presses),
            "memory": memory(service, browser, asked.minutes),
        }
    print(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
