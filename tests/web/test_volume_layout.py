"""Layout of the volume view: what its tabs and views show without scrolling, at the sizes of common screens."""

import pytest
from playwright.sync_api import expect

from steradian_client import Client
from support.recordings import INTERVAL, SOUND_SPEED, ball
from support.series_scan import write_scan
from support.views import drawn

DESKTOP, LARGE, TABLET = ({"width": w, "height": h} for w, h in ((1280, 720), (1440, 900), (1024, 768)))


@pytest.fixture(scope="module")
def volume(service):
    """The reconstruction of a ball."""
    traces, positions = ball(64, 220, depth=1.2e-3)
    with Client(service.url) as client:
        scan = client.imports.import_arrays(traces, positions, sampling_interval=INTERVAL, sound_speed=SOUND_SPEED)
        return client.reconstructions.wait(client.reconstructions.create(scan.id, modes=64, depth_range=(0.0, 4e-3))).id


@pytest.fixture(scope="module")
def series(service, tmp_path_factory):
    """A series of two wavelengths."""
    with Client(service.url) as client:
        scan = client.imports.import_file(write_scan(tmp_path_factory.mktemp("scan") / "scan.h5", repeats=1))
        job = client.reconstructions.create(scan.id, modes=24, depth_range=(0.6e-3, 1.6e-3))
        return client.reconstructions.wait(job).id


@pytest.mark.parametrize("size", [DESKTOP, LARGE, TABLET], ids=["desktop", "large", "tablet"])
def test_whole_view_tab_is_visible_without_scrolling(service, open_page, series, size):
    """Of a series with depth as colour, which has the most lines."""
    page = drawn(open_page(service, f"/volumes/{series}#map=depth", viewport=size))
    tab = page.locator("#panel-View")
    assert tab.evaluate("(one) => one.scrollHeight <= one.clientHeight")
    ends = tab.bounding_box()
    for name in ("Brightest", "Fit", "Slices", "Projections", "Scan here"):
        box = tab.get_by_role("button", name=name).bounding_box()
        assert box["y"] + box["height"] <= min(ends["y"] + ends["height"], size["height"])
        assert box["height"] >= 24
    for place in tab.locator("[data-place] dd").all():
        assert place.bounding_box()["y"] < size["height"] - 20
    tops = {tab.bounding_box()["y"] for tab in page.get_by_role("tab").all()}
    assert len(tops) == 1, "the tabs are in one line"
    expect(page.locator("[data-where='x–y']")).to_be_visible()
