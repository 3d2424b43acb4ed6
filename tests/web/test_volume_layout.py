"""Layout of volumes, one and side by side: what is visible without scrolling, at the sizes of common screens."""

import re

import pytest
from playwright.sync_api import expect

from steradian_client import Client
from support.recordings import INTERVAL, SOUND_SPEED, ball
from support.series_scan import write_scan
from support.views import drawn

DESKTOP, LARGE, TABLET = ({"width": w, "height": h} for w, h in ((1280, 720), (1440, 900), (1024, 768)))

LETTERS = """(() => { window.letters = {};
  const proto = CanvasRenderingContext2D.prototype, {fillText, clearRect} = proto;
  const texts = (context) => (window.letters[context.canvas.dataset?.view] ??= []);
  proto.clearRect = function (...box) { texts(this).length = 0; clearRect.apply(this, box); };
  proto.fillText = function (text, x, y) { texts(this).push({text, x, y}); fillText.call(this, text, x, y); };
})()"""
"""What is written on each view's canvas since it was cleared."""
MICROMETRES = {"µm": 1, "mm": 1000}


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
    title = page.locator("[data-where='x–y']")
    expect(title).to_have_text(re.compile(r"^750 nm, maximum of z \S+ to \S+\smm$"))  # one volume at each wavelength
    assert title.evaluate("(one) => one.scrollWidth <= one.clientWidth")


@pytest.mark.parametrize("size", [DESKTOP, TABLET], ids=["desktop", "tablet"])
def test_depth_views_beside_measurements_have_ticks_and_scale_bar(service, open_page, volume, size):
    """With three kept measurements: at least 120 pixels, two depths in numbers, a bar shorter than the shown depth."""
    points = [
        {"kind": "point", "name": f"point {n}", "axis": "z", "slab": [1.2e-3] * 2, "start": [0, 0]} for n in range(3)
    ]
    with Client(service.url) as client:
        client.reconstructions.set_measurements(volume, points)
    page = open_page(service, "/scans", viewport=size)
    page.add_init_script(LETTERS)
    page.goto(f"{service.url}/volumes/{volume}")
    drawn(page)
    page.click("[data-tab='Measure']")
    expect(page.locator("[data-measurement]")).to_have_count(3)
    depths = page.get_attribute("#volume", "data-depths").split(",")
    for view in ("x–z", "y–z"):
        assert page.locator(f"[data-view='{view}']").bounding_box()["height"] >= 120
        letters = page.evaluate("(view) => window.letters[view]", view)
        assert len([one for one in letters if one["x"] == 11 and re.fullmatch(r"[0-9.]+", one["text"])]) >= 2
        (bar,) = (told for one in letters if (told := re.fullmatch(r"([0-9.]+) (mm|µm)", one["text"])))
        length = float(bar[1]) * MICROMETRES[bar[2]] / 1000
        assert length < 0.6 * (float(depths[1]) - float(depths[0]))
    rows = page.get_by_role("region", name="Table of measurements")
    assert rows.locator("tbody tr").nth(1).bounding_box()["y"] < size["height"] - 30


def test_line_of_the_address_that_is_kept_is_not_measured_again(service, open_page, volume):
    """As after a reload: its name is said, and nothing is offered."""
    with Client(service.url) as client:
        client.reconstructions.set_measurements(volume, [])
    address = f"/volumes/{volume}#tool=line&slab=0,0,0&at=0,0,1.2&line=z,-0.7,0,1.1,0.1"
    page = drawn(open_page(service, address))
    page.click("[data-tab='Measure']")
    page.get_by_role("button", name="Measure the line").click()
    expect(page.locator("[data-measurement='profile 1']")).to_be_visible()
    expect(page.get_by_role("button", name="Measure the line")).to_have_count(0)
    page = drawn(open_page(service, address))
    page.click("[data-tab='Measure']")
    expect(page.get_by_text("This line is kept as profile 1.")).to_be_visible()
    expect(page.get_by_role("button", name="Measure the line")).to_have_count(0)
    with Client(service.url) as client:
        client.reconstructions.set_measurements(volume, [])


def test_every_depth_says_what_it_is(service, open_page, volume):
    """Depth views, box of the 3-D view and projection agree with the volume; a hidden near field moves all three."""
    page = drawn(open_page(service, f"/volumes/{volume}"))
    shown = [max(0, float(one)) for one in page.get_attribute("#volume", "data-depths").split(",")]
    first, last = page.get_by_label("Shown depth, from (mm)"), page.get_by_label("Shown depth, to (mm)")
    assert [float(one.input_value()) for one in (first, last)] == pytest.approx(shown, abs=0.01)
    box = re.search(r", z (\S+) to (\S+) mm$", page.inner_text("[data-where='3-D']"))
    assert [float(one) for one in box.groups()] == pytest.approx(shown, abs=0.06)
    expect(page.get_by_role("button", name="All depths, 0.0 to 4.0 mm")).to_be_visible()
    page.get_by_label("Hidden near field, up to (mm)").fill("0.5")
    expect(page.locator("[data-where='x–y']")).to_have_text(re.compile(r"^maximum of z 0\.49 to 4\.0\d\smm$"))
    expect(page.locator("#volume")).to_have_attribute("data-depths", re.compile(r"^0\.[45]"))
    expect(page.locator("[data-where='3-D']")).to_have_text(re.compile(r", z 0\.5 to "))
    page.goto(f"{service.url}/volumes")
    card = page.get_by_role("link").filter(has=page.locator(f"canvas[data-of='{volume}']"))
    expect(card).to_contain_text(re.compile(r"mm, z\s0\.00\sto\s4\.0\d\smm"))


@pytest.mark.parametrize("fragment", ["", "#camera=-35,25,1.6"], ids=["whole", "near"])
def test_axis_names_of_the_3d_view_are_whole(service, open_page, series, fragment):
    """On a tablet, also where the box exceeds the view."""
    page = open_page(service, "/scans", viewport=TABLET)
    page.add_init_script(LETTERS)
    page.goto(f"{service.url}/volumes/{series}{fragment}")
    drawn(page)
    page.wait_for_function("() => window.letters['3-D']?.length")
    box = page.locator("[data-view='3-D']").bounding_box()
    names = [one for one in page.evaluate("() => window.letters['3-D']") if one["text"] in {"x", "y", "z"}]
    assert len(names) == 3
    for one in names:
        assert 6 <= one["x"] <= box["width"] - 6
        assert 6 <= one["y"] <= box["height"] - 6


@pytest.mark.parametrize(("size", "share"), [(DESKTOP, 0.8), (TABLET, 0.7)], ids=["desktop", "tablet"])
def test_images_side_by_side_fill_the_window(service, open_page, volume, size, share):
    """Two square images have most of the height under them; long ones the width; *Close* is at the right end."""
    page = open_page(service, f"/reconstructions?side={volume},{volume}", viewport=size)
    page.wait_for_function("() => document.querySelectorAll('.message').length === 2")
    first, second = (page.locator("[data-view]").nth(n) for n in (0, 1))
    box, panel = first.bounding_box(), page.locator("#side").bounding_box()
    assert min(box["width"], box["height"]) > min(share * (size["height"] - box["y"]), 0.44 * panel["width"])
    assert box["y"] + box["height"] < size["height"]
    assert second.bounding_box()["y"] == box["y"]
    close = page.get_by_role("link", name="Close").bounding_box()
    assert panel["x"] + panel["width"] - close["x"] - close["width"] < 20
    page.get_by_label("Plane").select_option("y")
    expect(page.locator("[data-where='x–z']").first).to_be_visible()
    assert first.bounding_box()["width"] > 0.9 * panel["width"]


def test_thumbnails_have_scale_bars_and_dates_one_format(service, open_page, volume):
    """In both lists, a bar is as long as it says; dates are YYYY-MM-DD HH:MM, those of a job with seconds."""
    with Client(service.url) as client:
        shape, spacing = (client.reconstructions.get(volume).report[name] for name in ("shape", "spacing_m"))
        scan = client.reconstructions.get(volume).scan_id
    side = 1e3 * max(count * step for count, step in zip(shape[:2], spacing[:2], strict=True))
    page = open_page(service, "/volumes")
    expect(page.get_by_text("Each has its own colour scale.")).to_be_visible()
    date = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d(?!:)")
    expect(page.locator(f"li:has([data-of='{volume}'])")).to_contain_text(date)
    for address, of in (("/volumes", volume), ("/scans", scan)):
        page.goto(service.url + address)
        bar = page.locator(f"[data-of='{of}'] ~ .scale-bar")
        expect(bar).to_have_text("2 mm")
        whole = page.locator(f"[data-of='{of}']").bounding_box()["width"]
        assert bar.bounding_box()["width"] == pytest.approx(whole * 2 / side, abs=1.5)
    expect(page.locator(f"tr:has([data-of='{scan}'])")).to_contain_text(date)
    page.goto(f"{service.url}/reconstructions/{volume}")
    expect(page.locator("dt:text-is('Ended') + dd")).to_have_text(re.compile(date.pattern.replace("(?!:)", r":\d\d$")))
