"""Study of half a day on the page: each step takes at most three presses beside numbers typed, and its time is printed.

A press is a click, a double click, a drag, or a choice from a list.
"""

import re
import time

import pytest
from playwright.sync_api import expect

from steradian_client import Client
from support.series_scan import SATURATION, write_scan
from support.views import drawn, pixel_of

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(900)]
COUNT = """() => {
  window.presses = 0;
  if (window.counting) return;
  window.counting = true;
  const count = (event) => { window.presses += event.isTrusted && !event.target.closest("select") ? 1 : 0; };
  addEventListener("pointerdown", count, true);
  addEventListener("change", (event) => { window.presses += event.target.matches("select") ? 1 : 0; }, true);
}"""
MOST = 3


class Steps:
    """Steps on a page, each with its presses and seconds."""

    def __init__(self, page):
        self.page, self.rows, self._begun = page, [], 0.0

    def begin(self):
        """Begin a step on the page that is shown."""
        self.page.evaluate(COUNT)
        self._begun = time.monotonic()

    def end(self, step):
        """End a step; it may have taken :data:`MOST` presses."""
        presses = self.page.evaluate("() => window.presses")
        self.rows.append((step, presses, time.monotonic() - self._begun))
        assert presses <= MOST, f"{step}: {presses} presses"

    def table(self):
        """Return the steps as text."""
        return "\n".join(f"{presses} presses {seconds:7.1f} s  {step}" for step, presses, seconds in self.rows)


@pytest.fixture(scope="module")
def series(service, tmp_path_factory):
    with Client(service.url) as client:
        scan = client.imports.import_file(write_scan(tmp_path_factory.mktemp("scan") / "scan.h5", repeats=1))
        job = client.reconstructions.create(scan.id, modes=24, depth_range=(0.6e-3, 1.6e-3))
        return client.reconstructions.wait(job)


@pytest.fixture
def steps(service, open_page, series):
    steps = Steps(drawn(open_page(service, f"/volumes/{series.id}")))
    yield steps
    print(f"\n{steps.table()}")


def test_second_wavelength_width_figure_and_oxygen_take_three_presses_each(steps, service, series):
    page = steps.page
    steps.begin()
    page.get_by_label("Wavelength").select_option(label="850 nm")
    expect(page.locator("[data-volume-name]")).to_have_text(re.compile("850 nm"))
    steps.end("the second wavelength")

    steps.begin()
    page.locator("[data-view='x–z']").dblclick()
    box = page.locator("[data-view='x–z']").bounding_box()
    assert max(box["width"], box["height"]) >= 560
    steps.end("a view enlarged")
    page.locator("[data-view='x–z']").dblclick()

    drawn(page)
    page.goto(f"{service.url}/volumes/{series.id}#index=1&slab=all,all,all&tool=line&depth=0.6,1.6")
    drawn(page)
    with Client(service.url) as client:
        volume = client.reconstructions.volume(series.id, index=1)
    steps.begin()
    page.click("[data-tab='Measure']")
    x0, z = (
        1e3 * line[volume.values.max(axis=other).argmax()] for line, other in ((volume.x, (1, 2)), (volume.z, (0, 1)))
    )
    box = page.locator("[data-view='x–z']").bounding_box()
    for side, act in ((-0.7, page.mouse.down), (0.7, page.mouse.up)):
        x, y = pixel_of(page, volume, "x–z", (x0 + side, 0, z))
        page.mouse.move(box["x"] + x, box["y"] + y, steps=3)
        act()
    expect(page.locator("[data-measurement='profile 1'] [data-cell='width']")).to_contain_text("µm")
    steps.end("a width, measured and kept")

    steps.begin()
    page.get_by_role("button", name="Figure …").click()
    page.get_by_role("button", name="Create the figure").click()
    with page.expect_download() as download:
        page.get_by_role("link", name="Download PDF").click()
    assert download.value.path().read_bytes().startswith(b"%PDF")
    steps.end("a figure in PDF")

    steps.begin()
    page.click("[data-tab='Unmix']")
    page.get_by_label("Light at a depth").select_option("uniform")
    page.get_by_role("button", name="Unmix").click()
    found = page.locator("[data-unmixing] [data-saturation]")
    expect(found).to_be_visible()
    assert abs(float(found.get_attribute("data-saturation")) - SATURATION) < 0.05
    steps.end("oxygen saturation")


def test_budget_takes_three_presses(service, open_page):
    page = open_page(service, "/design?mask=grid&side=9&aperture=0.005&depth=0.0015&interval=0.0005")
    expect(page.get_by_role("button", name="Scan this")).to_be_enabled()
    panel, steps = page.get_by_role("region", name="Pulse budget"), Steps(page)
    steps.begin()
    for label, value in {"Time (min)": "0.4", "Signal-to-noise of one pulse (dB)": "25"}.items():
        panel.get_by_label(label).fill(value)
    panel.get_by_role("button", name="Propose").click()
    expect(panel.locator(".caption[aria-live]")).to_contain_text("; proposed")
    panel.get_by_role("button", name=re.compile("^Use [0-9]")).click()
    steps.end("points and averages of a time")
    print(f"\n{steps.table()}")
