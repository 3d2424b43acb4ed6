"""The volume's page shows where a ball is, how large it is and what it is made of: in figures, pixels and files."""

import csv
import io
import re
import subprocess
import sys

import numpy as np
import pytest
from playwright.sync_api import expect

import steradian
from steradian_client import Client
from support.recordings import INTERVAL, RADIUS, SOUND_SPEED, ball
from support.views import (
    AXES,
    VIEWS,
    brightest_pixel,
    crosshair,
    drawn,
    figure,
    number_in,
    pixel_of,
    shown_depths,
    spacing,
)

PLACE = (0.3, -0.15, 1.2)
"""Of the ball, in mm."""


@pytest.fixture(scope="module")
def made(service):
    """A ball's reconstruction, one by another method, and one at another speed of sound."""
    traces, positions = ball(64, 220, depth=PLACE[2] * 1e-3)
    with Client(service.url) as client:
        scan = client.imports.import_arrays(traces, positions, sampling_interval=INTERVAL, sound_speed=SOUND_SPEED)
        others = ({}, {"method": "nearest"}, {"sound_speed": SOUND_SPEED + 30})
        jobs = [client.reconstructions.create(scan.id, modes=128, depth_range=(0.0, 4e-3), **one) for one in others]
        views = [client.reconstructions.wait(job) for job in jobs]
        volumes = [client.reconstructions.volume(job.id) for job in jobs]
    return [view.id for view in views], volumes


@pytest.fixture
def page(open_page, service, made):
    """The ball's page, all views drawn."""

    def show(fragment="", **options):
        return drawn(open_page(service, f"/volumes/{made[0][0]}{fragment}", **options))

    return show


def test_a_click_moves_the_crosshair_in_every_view(page, made):
    """A place clicked in x–z is where the others go; the third coordinate stays."""
    page, volume = page("#depth=0,all"), made[1][0]
    wanted = (-0.8, PLACE[1], 2.4)
    x, y = pixel_of(page, volume, "x–z", wanted)
    page.locator("[data-view='x–z']").click(position={"x": x, "y": y})
    assert crosshair(page) == pytest.approx(wanted, abs=0.05)
    page.locator("[data-view='x–y']").focus()
    page.keyboard.press("ArrowRight")
    assert crosshair(page)[0] == pytest.approx(wanted[0] + spacing(volume)[0], abs=0.05)
    page.keyboard.press("PageDown")  # from the projection to the slice
    page.keyboard.press("PageDown")
    assert crosshair(page)[2] == pytest.approx(wanted[2] + spacing(volume)[2], abs=0.05)


def test_any_view_is_enlarged_by_double_click_and_key(page, made):
    """One view has the room of all four, its image at least 560 pixels at 1280 × 720; the others come back."""
    page, volume = page(), made[1][0]
    panes = page.locator(".pane:visible")
    page.locator("[data-view='x–y']").dblclick()
    expect(panes).to_have_count(1)
    box = page.locator("[data-view='x–y']").bounding_box()
    extents = np.multiply(volume.values.shape, spacing(volume))[:2]
    image = extents.min() * 0.985 * min(box["width"] / extents[0], box["height"] / extents[1])
    assert image >= 560
    assert box["y"] + box["height"] <= 720
    expect(page.locator(".large-name")).to_contain_text("nedner")
    page.keyboard.press("Escape")
    expect(page.locator(".large-name")).to_be_hidden()
    expect(panes).to_have_count(4)
    page.locator("[data-view='3-D']").focus()
    page.keyboard.press("f")
    expect(panes).to_have_count(1)
    expect(page.locator("[data-view='3-D']")).to_be_visible()
    page.get_by_role("button", name="Show all views").click()
    expect(panes).to_have_count(4)


def test_zoom_keeps_the_crosshair_where_it_is_in_every_view(page):
    """At four times the size the ball, on which the crosshair is, lies at the same pixels in all views."""
    x, y, z = PLACE
    page = page(f"#at={x},{y},{z}")
    images = [page.locator(f"[data-image='{view}']") for view in VIEWS]
    before = [brightest_pixel(image) for image in images]
    box = page.locator("[data-view='x–y']").bounding_box()
    page.mouse.move(box["x"] + 30, box["y"] + 40)  # far from the ball
    page.keyboard.down("Control")
    page.mouse.wheel(0, -600)
    page.wait_for_function("() => location.hash.includes('zoom=4')")
    for image, seen in zip(images, before, strict=True):
        now = brightest_pixel(image)
        assert (now["x"], now["y"]) == pytest.approx((seen["x"], seen["y"]), abs=5)


def test_depths_without_signal_are_not_shown_until_asked_for(page, made):
    """The views show the ball and a margin, all depths by a button, those of two numbers, and the ball again."""
    page, volume = page(), made[1][0]
    first, last = shown_depths(page)
    assert first < PLACE[2] - 0.3
    assert PLACE[2] + 0.3 < last < 1e3 * volume.z[-1] - 0.5
    page.get_by_role("button", name="All depths").click()
    expect(page.locator("#volume")).to_have_attribute("data-depths", re.compile(r"^-?0\.0"))
    assert shown_depths(page)[1] == pytest.approx(1e3 * volume.z[-1], abs=spacing(volume)[2])
    page.get_by_label("Shown depth, to (mm)").fill("2.5")
    page.get_by_label("Shown depth, to (mm)").blur()
    page.wait_for_function("() => document.querySelector('#volume').dataset.depths.endsWith('2.5000')")
    page.get_by_role("button", name="Object").click()
    expect(page.locator("#volume")).to_have_attribute("data-depths", f"{first:.4f},{last:.4f}")


def test_readout_is_whole_and_its_value_is_numpy_s(page, made):
    """At the edge of a small view, too; a coordinate that rounds to zero has no sign."""
    page, volume = page("#at=-0.001,0.5,1"), made[1][0]
    assert page.inner_text("[data-place] [data-axis='x']") == "0.00 mm"
    place = (-1e-3, 0.5, 1.0)
    x, y = pixel_of(page, volume, "x–z", place)
    view = page.locator("[data-view='x–z']")
    view.hover(position={"x": round(x), "y": round(y)})
    said = page.locator("[data-cursor]")
    told = re.fullmatch(r"x (\S+), z (\S+) mm: (\S+)\sarb\.\su\.", said.inner_text())
    lines = [1e3 * np.array(line) for line in (volume.x, volume.z)]
    mm = [float(one.replace("−", "-")) for one in told.groups()[:2]]
    i, k = (np.abs(line - one).argmin() for line, one in zip(lines, mm, strict=True))
    near = volume.values.max(axis=1)[i - 1 : i + 2, k - 1 : k + 2]
    assert near.min() * 0.99 <= float(told[3].replace(",", "")) <= near.max() * 1.01
    for place in ((3, 3), (-4, 3), (3, -4), (-4, -4)):
        box, frame = view.bounding_box(), page.locator(".canvases:has([data-view='x–z'])").bounding_box()
        view.hover(position={"x": place[0] % box["width"], "y": place[1] % box["height"]})
        if said.is_visible():
            inner = said.bounding_box()
            assert inner["x"] >= frame["x"]
            assert inner["x"] + inner["width"] <= frame["x"] + frame["width"]
            assert said.evaluate("(one) => one.scrollWidth <= one.clientWidth")


def test_a_region_is_numpy_s(page, made):
    """Mean, deviation and contrast of rectangles in a slice are those of the volume's values there."""
    page, volume = page("#slab=0,0,0&tool=region&region=z,-0.5,-0.6,0.75,0.4&background=z,1,1,2,2"), made[1][0]
    page.click("[data-tab='Measure']")
    page.get_by_role("button", name="Measure the background").click()
    page.wait_for_selector("[data-result='contrast']")
    k = np.unravel_index(volume.values.argmax(), volume.values.shape)[2]
    x, y = 1e3 * np.array(volume.x), 1e3 * np.array(volume.y)
    inside = volume.values[(x >= -0.5) & (x <= 0.75), :, k][:, (y >= -0.6) & (y <= 0.4)].astype(float)
    outside = volume.values[(x >= 1) & (x <= 2), :, k][:, (y >= 1) & (y <= 2)].astype(float)
    assert figure(page, "contrast") == pytest.approx((inside.mean() - outside.mean()) / outside.std(), rel=1e-3)
    page.get_by_role("button", name="Measure the region").click()
    page.wait_for_selector("[data-result='region'] [data-figure='mean']")
    for key, wanted in (("mean", inside.mean()), ("deviation", inside.std())):
        assert figure(page, key) == pytest.approx(wanted, rel=1e-4)
        assert page.inner_text(f"[data-result='region'] [data-figure='{key}']").endswith("arb.\u00a0u.")
    for name in ("contrast 1", "region 1"):
        page.get_by_role("button", name=f"Remove {name}").click()
        expect(page.locator(f"[data-measurement='{name}']")).to_have_count(0)


def test_an_address_shows_the_same_view(page):
    """Slices, window, colours, crosshair, zoom and the turned 3-D view are in the address, and come back from it."""
    page_ = page()
    page_.locator("[data-view='x–y']").click(position={"x": 60, "y": 60})
    page_.locator("[data-view='x–y']").focus()
    for key in ("m", "+", "+"):
        page_.keyboard.press(key)
    page_.locator("[data-handle='high']").focus()
    page_.keyboard.press("ArrowLeft")
    page_.select_option("#map", "cividis")
    page_.locator("[data-view='3-D']").focus()
    page_.keyboard.press("ArrowLeft")
    parts = ["at=", "slab=", "window=", "map=cividis", "zoom=", "camera="]
    page_.wait_for_function("(parts) => parts.every((one) => location.hash.includes(one))", arg=parts)
    shown = page_.url
    again = page(shown[shown.index("#") :])
    assert crosshair(again) == pytest.approx(crosshair(page_), abs=1e-4)
    assert again.url == shown
    again.wait_for_function(SAME, arg=page_.evaluate(PICTURES))


BAR = "() => [...document.querySelector('.colour-bar').getContext('2d').getImageData(0, 0, 256, 1).data]"


def test_the_histogram_s_bar_is_that_of_the_handles(page, made):
    """Ends in numbers; constant beyond the handles; where colours mean depth, it is one of depths."""
    greatest = made[1][0].values.max()
    page_ = page(f"#window=0,{greatest / 2}&map=grey")
    page_.wait_for_function("() => document.querySelector('[data-end=greatest]').textContent !== ''")
    assert float(page_.inner_text("[data-end='greatest']")) == pytest.approx(greatest, rel=0.01)
    red = np.array(page_.evaluate(BAR)).reshape(256, 4)[:, 0]
    assert (red[-100:] == 255).all(), "brighter than the window is as bright as its end"
    assert (np.diff(red) >= 0).all()
    expect(page_.get_by_text("depth colour scale")).to_be_hidden()
    page_.select_option("#map", "depth")
    expect(page_.get_by_text("depth colour scale")).to_be_visible()
    page_.wait_for_function(f"() => {{ const [r,, b] = ({BAR})(); return r > b; }}")


KEY = """() => { const canvas = document.querySelector("[data-view='3-D']"), y = canvas.clientHeight - 13;
return [...canvas.getContext("2d").getImageData(12, y, 110, 1).data]; }"""


def test_3d_view_shows_box_size_and_depth_colour_key(page, made):
    """Before anything is moved, and while another tab than that with the colours is open."""
    page_, volume = page("#map=depth"), made[1][0]
    sides = [float(one) for one in re.findall(r"[0-9.]+", page_.inner_text("[data-where='3-D']"))]
    assert sides[:2] == pytest.approx([1e3 * (line[-1] - line[0]) for line in (volume.x, volume.y)], abs=0.15)
    assert sides[2:] == pytest.approx(np.clip(shown_depths(page_), 0, None), abs=0.06)
    page_.get_by_label("Box: x to").fill("0.5")
    expect(page_.locator("[data-where='3-D']")).to_contain_text(re.compile(r"^x −[0-9.]+ to −?0\.[01], y .* mm$"))
    track = page_.locator(".range").first.bounding_box()  # of x, whose thumbs are at 0 and 0.5
    for name, start, end in (("from", 0, 0.2), ("to", 0.5, 0.9)):
        places = [track["x"] + 8 + share * (track["width"] - 16) for share in (start, end)]  # middles of a thumb of 16
        page_.mouse.move(places[0], track["y"] + track["height"] / 2)
        page_.mouse.down()
        page_.mouse.move(places[1], track["y"] + track["height"] / 2, steps=4)
        page_.mouse.up()
        assert float(page_.get_by_label(f"Box: x {name}").input_value()) == pytest.approx(end, abs=0.04)
    for name, value in (("from", "0"), ("to", "0.5")):
        page_.get_by_label(f"Box: x {name}").fill(value)
    bar, key = (np.array(page_.evaluate(one), int).reshape(-1, 4)[:, :3] for one in (BAR, KEY))
    assert np.abs(key[[2, -3]] - bar[[5, -6]]).max() < 24
    assert np.abs(key[2] - key[-3]).max() > 60
    page_.click("[data-tab='Measure']")
    assert np.array_equal(np.array(page_.evaluate(KEY)).reshape(-1, 4)[:, :3], key)


PICTURES = "() => [...document.querySelectorAll('[data-image]')].map((one) => one.toDataURL())"
SAME = f"(wanted) => JSON.stringify(({PICTURES})()) === JSON.stringify(wanted)"


def test_compare_tab_shows_correlation_and_difference_to_reference(page, made):
    """Two images of the same voxels: their projections' correlation is NumPy's; where they are alike it is dark."""
    page, volumes = page(f"#against={made[0][1]}"), made[1][:2]
    page.click("[data-tab='Compare']")
    page.wait_for_selector("[data-figure='correlation-z']")
    for n, axis in enumerate(AXES):
        one, other = (volume.values.max(axis=n).ravel().astype(float) for volume in volumes)
        assert figure(page, f"correlation-{axis}") == pytest.approx(np.corrcoef(one, other)[0, 1], abs=1e-4)
    assert page.inner_text("[data-where='x–y']") == "difference, maximum of z 0.00 to 4.00\u00a0mm"
    page.get_by_role("button", name="Compare the whole volumes").click()
    page.wait_for_selector("[data-figure='volume_correlation']")
    whole = np.corrcoef(*(volume.values.ravel().astype(float) for volume in volumes))[0, 1]
    assert figure(page, "volume_correlation") == pytest.approx(whole, abs=1e-4)
    assert all(one.get_attribute("title") for one in page.locator("dt:has(+ [data-figure^='volume_'])").all())
    page.click("[data-how='blink']")
    page.wait_for_function("() => document.querySelector('#panel-Compare').innerText.includes('now: the reference')")
    expect(page.locator("[data-where='x–y']")).to_have_text("maximum of z 0.00 to 4.00 mm")


def test_images_of_other_voxels_are_not_subtracted(page, made):
    """At another speed of sound voxels lie at other depths: that is said, and they can be seen by turns."""
    page = page(f"#against={made[0][2]}")
    page.click("[data-tab='Compare']")
    page.wait_for_function("() => document.querySelector('#panel-Compare').innerText.includes('cannot be subtracted')")
    page.click("[data-how='blink']")
    page.wait_for_function("() => document.querySelector('#panel-Compare').innerText.includes('now: the reference')")


def test_sound_speed_is_shown_with_error_and_unit(service, open_page, made):
    found = {"sound_speeds": [1450, 1500, 1550], "sharpness": [1, 2, 1], "best": 1500.2, "standard_error": 0.2}
    job = {"state": "succeeded", "ended": "2026-01-01T00:00:00Z", "result": found | {"at_edge": False}}
    page = open_page(service, "/healthz")
    page.route("**/api/v1/jobs?kind=sound-speed*", lambda route: route.fulfill(json={"items": [job]}))
    page.goto(f"{service.url}/volumes/{made[0][0]}")
    page.click("[data-tab='Speed']")
    expect(page.get_by_text("Best fit at 1500.2 ± 0.2 m/s")).to_be_visible()
    expect(page.get_by_text(f"Dashed line: this volume, {SOUND_SPEED:.1f} m/s")).to_be_visible()


def test_medium_search_is_shown_with_error_and_unit_of_each_parameter(service, open_page, made):
    found = {"name": "layer1.thickness", "value": 2e-3, "standard_error": 1e-5, "unit": "m", "at_edge": False}
    job = {"state": "succeeded", "ended": "2026-01-01T00:00:00Z", "result": {"parameters": [found]}}
    page = open_page(service, "/healthz")
    page.route("**/api/v1/jobs?kind=sound-speed*", lambda route: route.fulfill(json={"items": [job]}))
    page.goto(f"{service.url}/volumes/{made[0][0]}")
    page.click("[data-tab='Speed']")
    expect(page.get_by_text("layer1.thickness: 0.0020000 ± 0.000010 m")).to_be_visible()


def test_named_profiles_are_kept_with_widths_and_correction(service, open_page, page, made):
    """Two lines are drawn, one renamed and corrected; another browser sees both, and the CSV file has them."""
    x, y, z = PLACE
    page, volume = page(f"#at={x},{y},{z}&slab=0,0,0&tool=line&depth=0,all"), made[1][0]
    page.click("[data-tab='Measure']")
    for n, view in enumerate(("x–y", "x–z"), 1):
        box = page.locator(f"[data-view='{view}']").bounding_box()
        for side, act in ((-0.9, page.mouse.down), (0.9, page.mouse.up)):
            at = pixel_of(page, volume, view, (x + side, y, z))
            page.mouse.move(box["x"] + at[0], box["y"] + at[1], steps=3)
            act()
        expect(page.locator(f"[data-measurement='profile {n}'] [data-cell='width']")).to_contain_text("µm")
    name = page.get_by_label("Name of measurement 1")
    name.fill("ball")
    name.press("Enter")
    page.get_by_role("button", name="Correct the width of ball").click()
    expect(page.locator("[data-measurement='ball'] [data-cell='corrected']")).to_contain_text("µm", timeout=120_000)
    text = page.locator("[data-result='profile']").inner_text()
    corrected = float(re.search(r"Corrected width\s+([\d.]+) µm, as a Gaussian sphere", text)[1])
    assert corrected == pytest.approx(2 * (2 * np.log(2)) ** 0.5 * 1e6 * RADIUS, rel=0.06)
    assert float(re.search(r"Point spread\s+([\d.]+) µm", text)[1]) < corrected
    other = open_page(service, f"/volumes/{made[0][0]}")
    expect(other.locator("[data-measurement]")).to_have_count(2)
    expect(other.locator("[data-measurement='ball'] [data-cell='corrected']")).to_have_text(f"{corrected:g} µm")
    with page.expect_download() as download:
        page.get_by_role("button", name="Download the measurements as CSV").click()
    rows = list(csv.DictReader(io.StringIO(download.value.path().read_text())))
    assert [row["name"] for row in rows] == ["ball", "profile 2"]
    assert 1e6 * float(rows[0]["corrected"]) == pytest.approx(corrected, abs=0.5)
    page.get_by_text("Several volumes").click()
    page.locator(f"[data-volumes] input[value='{made[0][1]}']").check()
    page.get_by_role("button", name="Measure in these volumes").click()
    expect(page.get_by_text("Measured in all of them")).to_be_visible()
    with page.expect_download() as download:
        page.get_by_role("button", name="Table of all volumes").click()
    rows = list(csv.DictReader(io.StringIO(download.value.path().read_text())))
    assert [(row["reconstruction_id"], row["name"]) for row in rows] == [
        (volume_id, name) for volume_id in made[0][:2] for name in ("ball", "profile 2")
    ]
    for name in ("ball", "profile 2"):
        page.get_by_role("button", name=f"Remove {name}").click()
        expect(page.locator(f"[data-measurement='{name}']")).to_have_count(0)


def test_selected_points_in_volume_fill_mask_design(service, page, made):
    """One point by a click in x–z; one by a click in x–y that is dragged in x–z to its depth; both fill the design."""
    page, volume = page("#tool=point&depth=0,all"), made[1][0]
    page.click("[data-tab='Measure']")
    deep, shallow = (-0.8, PLACE[1], 2.4), (0.7, 0.5, 1.0)
    x, y = pixel_of(page, volume, "x–z", deep)
    page.locator("[data-view='x–z']").click(position={"x": x, "y": y})
    x, y = pixel_of(page, volume, "x–y", shallow)
    page.locator("[data-view='x–y']").click(position={"x": x, "y": y})
    box = page.locator("[data-view='x–z']").bounding_box()
    (x0, y0), (x1, y1) = (pixel_of(page, volume, "x–z", (0.7, 0.5, depth)) for depth in (deep[2], shallow[2]))
    page.mouse.move(box["x"] + x0, box["y"] + y0)
    page.mouse.down()
    page.mouse.move(box["x"] + x1, box["y"] + y1, steps=4)
    page.mouse.up()
    expect(page.locator("[data-result='points'] li")).to_have_count(2)
    scan = service.get(f"/reconstructions/{made[0][0]}").json()["scan_id"]
    mask = service.get(f"/masks/{service.get(f'/scans/{scan}').json()['mask_id']}").json()
    lead = page.get_by_role("link", name="Mask around these 2 points")
    expect(lead).to_have_attribute("href", re.compile(f"aperture={mask['aperture']}&"))
    lead.click()
    expect(page.locator("#arrangement")).to_have_value("combined")
    for n, point in (("", deep), ("2", shallow)):
        told = [number_in(page.locator(f"#field-{name}{n}")) for name in ("x", "y", "depth")]
        assert told == pytest.approx(point, abs=0.05)
    expect(page.get_by_role("button", name="Scan this")).to_be_enabled()


def test_points_of_interest_by_keys_and_fingers(page):
    """The crosshair is added from the keyboard, which stays where it is; two fingers that zoom add nothing."""
    page = page("#tool=point&at=0.5,0,1")
    page.click("[data-tab='Measure']")
    add, points = page.get_by_role("button", name="Add the crosshair"), page.locator("[data-result='points'] li")
    add.focus()
    for count in (1, 2):
        page.keyboard.press("Enter")
        expect(points).to_have_count(count)
        expect(add).to_be_focused()
    box = page.locator("[data-view='x–z']").bounding_box()
    hand = page.context.new_cdp_session(page)
    fingers = [{"x": box["x"] + x, "y": box["y"] + 60, "id": n} for n, x in enumerate((80, 140))]
    for so_far, count in (([fingers[0]], 3), (fingers, 2)):
        hand.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": so_far})
        expect(points).to_have_count(count)
    hand.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    page.get_by_role("button", name="Remove point 1").click()
    expect(points).to_have_count(1)


def test_the_command_line_makes_it_again(page, made, tmp_path):
    """The lines that the page tells make the same volume."""
    page, volume = page(), made[1][0]
    page.click("[data-tab='Made']")
    command = page.inner_text("[data-command='shell']")
    assert "steradian reconstruct" in command
    python = f"{sys.executable} -m steradian"
    script = command.replace("steradian reconstruct", f"{python} reconstruct").replace("curl -o", "curl -s -o")
    subprocess.run(["bash", "-e", "-c", script], cwd=tmp_path, check=True, capture_output=True, timeout=300)
    again = steradian.open(tmp_path / made[0][0])
    assert again.values.shape == volume.values.shape
    assert np.allclose(again.values, volume.values, rtol=1e-4, atol=1e-5 * volume.values.max())
