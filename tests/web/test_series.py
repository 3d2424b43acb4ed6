"""Six frames at two wavelengths on the page: import, series, playback, unmixing, and the picture of the saturation."""

import io
import itertools
import json
import re

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect

from steradian_client import Client
from support.page_modules import modules_of
from support.series_scan import SATURATION, write_scan
from support.views import drawn

FRAMES = 6
PIXELS = """(canvas) => {
    const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let sum = 0;
    for (let n = 0; n < data.length; n += 4) sum += data[n] + data[n + 1] + data[n + 2];
    return sum;
}"""


@pytest.fixture(scope="module")
def scan_file(tmp_path_factory):
    return write_scan(tmp_path_factory.mktemp("scan") / "scan.h5", repeats=FRAMES // 2)


@pytest.fixture(scope="module")
def series(service, scan_file):
    """A series of six volumes, and their maxima."""
    with Client(service.url) as client:
        scan = client.imports.import_file(scan_file)
        job = client.reconstructions.create(scan.id, modes=24, depth_range=(0.6e-3, 1.6e-3))
        job = client.reconstructions.wait(job)
        volumes = [client.reconstructions.volume(job.id, index=index).values for index in range(FRAMES)]
    return job, volumes


@pytest.fixture
def page(open_page, service, series):
    def show(fragment=""):
        return drawn(open_page(service, f"/volumes/{series[0].id}{fragment}"))

    return show


def test_scan_of_six_frames_goes_through_import_series_and_unmixing_to_a_picture(service, open_page, scan_file):
    page = open_page(service, "/data")
    page.set_input_files("#files", [scan_file])
    page.get_by_role("button", name="Import").click()
    page.get_by_role("button", name="Reconstruct").click()
    page.wait_for_url("**/reconstructions/r*")
    made = page.url.rpartition("/")[2]
    with Client(service.url) as client:
        client.reconstructions.wait(made)
    page.goto(f"{service.url}/reconstructions?again={made}")
    expect(page.locator("#of-frame option:checked")).to_have_text("all 6, as a series")
    page.goto(f"{service.url}/volumes/{made}")
    drawn(page)
    expect(page.locator(".volume-head")).to_contain_text("series of 6 volumes at 750 nm and 850 nm")
    page.click("[data-tab='Unmix']")
    expect(page.get_by_label("Light at a depth")).to_have_value("tissue")  # two wavelengths are too few for a fit
    expect(page.locator("#fluence option[value='fit']")).to_be_disabled()
    page.get_by_label("Light at a depth").select_option("uniform")
    page.get_by_role("button", name="Unmix").click()
    found = page.locator("[data-unmixing] [data-saturation]")
    expect(found).to_be_visible()
    assert abs(float(found.get_attribute("data-saturation")) - SATURATION) < 0.03
    page.get_by_role("link", name="Open the maps").click()
    drawn(page)
    expect(page.get_by_label("Volume of the series").locator("option")).to_have_text(
        ["saturation", "saturation-error", "haemoglobin", "oxyhaemoglobin", "deoxyhaemoglobin"]
    )
    page.click("[data-tab='Made']")
    expect(page.locator("[data-command='shell']")).to_contain_text("--fluence uniform")
    expect(page.get_by_role("link", name="Log and attempts")).to_be_visible()
    expect(page.get_by_role("link", name="Rerun …")).to_have_count(0)
    page.click("[data-tab='Files']")
    expect(page.get_by_text("A file contains all maps, with their names.")).to_be_visible()
    page.click("[data-tab='Oxygen']")
    with page.expect_download() as download:
        page.get_by_role("link", name="Download the picture").click()
    with Image.open(io.BytesIO(download.value.path().read_bytes())) as picture:
        assert min(picture.size) > 200


def test_selected_volume_and_its_values_are_shown_with_one_colour_scale(page, series):
    page, volumes = page("#index=4"), series[1]
    expect(page.locator("[data-series]")).to_have_text("5 of 6")
    choice = page.get_by_label("Volume of the series")
    expect(choice.locator("option:checked")).to_have_text(re.compile("850 nm, frame 4"))
    for name in ("x–y", "x–z", "3-D"):
        expect(page.locator(f"[data-where='{name}']")).to_contain_text("850 nm, frame 4")
    expect(page.locator("[data-volume-name]")).to_have_text(re.compile("850 nm, frame 4"))
    expect(page).to_have_title(re.compile("850 nm, frame 4"))
    bright = page.locator("[data-image='x–y']").evaluate(PIXELS)
    choice.select_option("0")
    expect(page.locator("[data-series]")).to_have_text("1 of 6")
    page.wait_for_function("() => location.hash === '' || !location.hash.includes('index')")
    ratio = volumes[0].max() / volumes[4].max()
    assert ratio < 0.8, "the ball absorbs less at 750 nm"
    page.wait_for_function(
        f"(bright) => ({PIXELS})(document.querySelector(\"[data-image='x–y']\")) < 0.95 * bright", arg=bright
    )
    expect(page.locator("[data-image='3-D']")).to_have_attribute("data-index", "0")
    expect(page.locator(".stale-note")).to_be_hidden()
    page.get_by_label("Wavelength").select_option(label="850 nm")
    expect(choice.locator("option")).to_have_count(3)
    expect(page.locator("[data-series]")).to_have_text("1 of 3")


def test_playback_shows_volume_after_volume_until_it_is_paused(page):
    page = page()
    page.evaluate(
        """() => {
            const status = document.querySelector("[data-series]");
            window.shown = [];
            const record = () => window.shown.push([Number.parseInt(status.textContent), performance.now()]);
            new MutationObserver(record).observe(status, {childList: true});
            window.began = performance.now();
            const button = document.querySelector("[data-play]");
            for (let n = 0; n < 3; n++) button.click(); // Play, Pause and Play: one loop, not two
        }"""
    )
    page.wait_for_function("() => window.shown.length >= 13")
    page.click("[data-play]")
    expect(page.locator("[data-play]")).to_have_text("Play")
    page.wait_for_function("() => document.querySelectorAll('.message:not([hidden])').length === 0")
    told = page.evaluate("() => window.shown.filter(([one], n, all) => one !== all[n - 1]?.[0])")
    shown = [number for number, _ in told]
    assert all(later == one % FRAMES + 1 for one, later in itertools.pairwise(shown)), shown
    assert told[-1][1] - page.evaluate("() => window.began") > 39 * (len(shown) - 2), "at most 25 a second"
    expect(page.locator("[data-series]")).to_have_text(f"{shown[-1]} of {FRAMES}")
    expect(page.locator("[data-image='3-D']")).to_have_attribute("data-index", str(shown[-1] - 1))


def test_playback_stops_at_a_volume_that_cannot_be_read(page):
    page = page("#index=3")
    page.provoked("status of 404")
    page.route(
        re.compile(r"/(volume|mip)\?.*index=5(&|$)"), lambda route: route.fulfill(status=404, json={"detail": "gone"})
    )
    page.click("[data-play]")
    expect(page.locator("[data-series]")).to_have_text(f"6 of {FRAMES}")
    expect(page.locator("[data-play]")).to_have_text("Play")
    expect(page.locator(".pane .message:not([hidden])").first).to_contain_text("gone")


def test_reference_that_is_a_series_shows_and_compares_the_same_volume(page, service, series):
    with Client(service.url) as client:
        other = client.reconstructions.create(series[0].scan_id, modes=24, depth_range=(0.6e-3, 1.6e-3))
        other = client.reconstructions.wait(other)
    page, asked = page(f"#index=4&against={other.id}"), []

    def answer(route):
        if route.request.method == "POST":
            asked.append(route.request.post_data_json)
            route.fulfill(json={"state": "failed", "error": {"detail": "not today"}})
        else:
            route.continue_()

    page.route("**/quality", answer)
    page.click("[data-tab='Compare']")
    status = page.get_by_role("tabpanel").get_by_text("The reference is volume")
    expect(status).to_contain_text("volume 5 of 6 of its series, as here: 850 nm, frame 4")
    page.get_by_label("Volume of the series").select_option("1")
    expect(status).to_contain_text("volume 2 of 6")
    page.wait_for_function("() => Number(document.querySelector('[data-figure=correlation-z]').dataset.value) > 0.999")
    page.get_by_role("button", name="Compare the whole volumes").click()
    expect(page.get_by_text("not today")).to_be_visible()
    assert asked == [{"reference_id": other.id, "index": 1, "reference_index": 1}]


HUES = """(canvas) => {
    const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    const most = [0, 0, 0];
    for (let n = 0; n < data.length; n += 4) for (const c of [0, 1, 2]) most[c] = Math.max(most[c], data[n + c]);
    return most;
}"""


GL_HUES = """(canvas) => {
    const flat = new OffscreenCanvas(canvas.width, canvas.height);
    flat.getContext("2d").drawImage(canvas, 0, 0);
    const {data} = flat.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    const most = [0, 0, 0];
    for (let n = 0; n < data.length; n += 4) for (const c of [0, 1, 2]) most[c] = Math.max(most[c], data[n + c]);
    return most;
}"""


def test_two_wavelengths_are_laid_over_each_other_in_their_own_colours(page, series):
    """Red is the volume at 850 nm, cyan that at 750 nm, each as bright as its values on one scale; or not shown."""
    job, volumes = series
    page = page(f"#index=4&against={job.id}:0&how=overlay&map=red&smooth=nearest")
    page.click("[data-tab='Compare']")
    expect(page.get_by_label("Reference", exact=True).locator("option:checked")).to_have_text(re.compile("750 nm"))
    expect(page.locator("[data-overlay] h3")).to_have_text(
        [re.compile("850 nm, frame 4"), re.compile("750 nm, frame 0")]
    )
    expect(page.locator("[data-where='x–y']")).to_contain_text(re.compile(r"850 nm, .*\+ 750 nm"))
    image = page.locator("[data-image='x–y']")
    peak = job.report["scale_ends"]["z"]
    expected = [255 * min(1, volumes[n].max() / peak) for n in (4, 0, 0)]
    page.wait_for_function(
        f"(least) => ({HUES})(document.querySelector(\"[data-image='x–y']\"))[1] >= least", arg=float(expected[1]) - 10
    )  # the overlay is painted after the volume
    assert image.evaluate(HUES) == pytest.approx(expected, abs=10)
    added = page.locator("[data-image='3-D overlay']")
    expect(added).to_be_visible()
    page.wait_for_function(f"() => ({GL_HUES})(document.querySelector(\"[data-image='3-D overlay']\"))[1] > 100")
    assert added.evaluate(GL_HUES)[0] == 0, "cyan has no red"
    page.get_by_role("button", name="Figure …").click()
    page.get_by_label("Format").select_option("svg")
    page.get_by_role("button", name="Create the figure").click()
    with page.expect_download() as download:
        page.get_by_role("link", name="Download SVG").click()
    assert download.value.path().read_text().count("<!-- 750 nm, frame 0") == 1  # its colour bar
    page.click("[data-tab='Compare']")
    page.get_by_label("Reference: opacity").fill("0")
    page.wait_for_function(f"() => ({HUES})(document.querySelector(\"[data-image='x–y']\"))[1] < 30")
    assert image.evaluate(HUES)[0] == pytest.approx(expected[0], abs=10)
    page.get_by_label("Volume of the series").select_option("1")  # the reference stays
    expect(page.locator("[data-overlay] h3").last).to_have_text(re.compile("750 nm, frame 0"))


def test_gallery_shows_each_wavelength_and_one_scale_on_request(service, open_page, series):
    """By themselves both volumes reach the brightest colour; on one scale 750 nm is darker than 850 nm."""
    job, volumes = series
    page = open_page(service, "/volumes")
    images = page.locator(f"canvas[data-of='{job.id}']")
    expect(images).to_have_count(2)
    page.get_by_label("Search").fill(job.id)  # the service has volumes of other tests
    expect(page.locator(".gallery canvas")).to_have_count(2)
    page.wait_for_function("() => [...document.querySelectorAll('.gallery canvas')].every((one) => one.width > 1)")
    expect(page.locator("[data-shown]")).to_have_text(re.compile(r"750 nm, frame 0.* \| 850 nm, frame 3"))
    assert images.nth(0).evaluate(HUES)[0] == images.nth(1).evaluate(HUES)[0] == 252  # inferno's last
    page.get_by_label("One colour scale").check()
    expect(page.locator("[data-scale]")).to_have_text(re.compile(r"Colours from 0 to [\d,]+\sarb\.\su\."))
    dark, bright = (images.nth(n).evaluate(PIXELS) for n in (0, 1))
    assert volumes[0].max() < 0.8 * volumes[3].max()
    assert dark < 0.9 * bright


def test_moving_the_crosshair_draws_another_slice(page, series):
    page = page("#slab=0,0,0")
    canvas = page.locator("[data-image='x–y']")
    before = canvas.evaluate(PIXELS)
    page.locator("[data-view='x–y']").focus()
    for _ in range(6):
        page.keyboard.press("PageDown")
    page.wait_for_function(
        f"(before) => ({PIXELS})(document.querySelector(\"[data-image='x–y']\")) < 0.8 * before", arg=before
    )


def test_course_of_a_region_is_numpy_s_of_each_volume(page, series):
    page = page("#slab=0,0,0.3&at=0,0,1&tool=region&region=z,-0.2,-0.2,0.2,0.2")
    page.click("[data-tab='Measure']")
    page.get_by_role("button", name="Measure the region").click()
    page.get_by_role("button", name="Course over the series").click()
    host = page.locator("[data-means]")
    expect(host.locator("canvas")).to_be_visible()
    told = json.loads(host.get_attribute("data-means"))
    text = page.locator("[data-course]").text_content()
    first, last = (1e-3 * float(end) for end in re.search(r"box, z ([0-9.]+)\D+([0-9.]+)", text).groups())
    assert abs(last - first - 0.3e-3) < 0.04e-3
    job, volumes = series
    x, y, z = (origin + step * np.arange(size) for origin, step, size in _axes(job.report))
    box = np.ix_(np.abs(x) <= 0.2e-3, np.abs(y) <= 0.2e-3, (z > first) & (z < last))
    assert told == pytest.approx([volume[box].mean() for volume in volumes], rel=1e-5)


def _axes(report):
    return zip(report["origin_m"], report["spacing_m"], report["shape"], strict=True)


@pytest.mark.parametrize(("format", "begins"), [("svg", b"<?xml"), ("gif", b"GIF8")])
def test_figure_of_the_view_is_downloaded(page, format, begins):
    page = page("#index=4&slab=all,0,all&at=0,0,1&zoom=2&gamma=0.5&depth=0.8,1.4&map=cyan")
    page.get_by_role("button", name="Figure …").click()
    page.get_by_label("Shows").select_option(label="x–y and x–z")
    page.get_by_label("Format").select_option(format)
    page.get_by_role("button", name="Create the figure").click()
    with page.expect_download() as download:
        page.get_by_role("link", name=f"Download {format.upper()}").click()
    data = download.value.path().read_bytes()
    assert data.startswith(begins)
    if format == "svg":
        assert b"frame 4" in data
        assert data.count(b"<!-- z (mm) -->") == 1  # beside that of x and y


def test_figure_beyond_its_limits_and_a_film_of_depths_are_not_requested(page, service, series):
    page = page("#map=depth")
    page.click("[data-tab='Files']")
    expect(page.get_by_label("Format").locator("option")).to_have_text(["PDF", "SVG", "PNG"])
    page.get_by_label("Width (mm)").fill("30")
    page.get_by_role("button", name="Create the figure").click()
    expect(page.get_by_text("from 35 to 1000 mm")).to_be_visible()
    expect(page.get_by_label("Width (mm)")).to_be_focused()
    long = service.get(f"/reconstructions/{series[0].id}").json()
    long["report"]["frames"] *= 4  # 24 volumes: 48 panels of two planes
    page.route(f"**/reconstructions/{series[0].id}", lambda route: route.fulfill(json=long))
    page.reload()
    page.click("[data-tab='Files']")
    page.get_by_label("Volumes", exact=True).select_option("all")
    page.get_by_label("Shows").select_option(label="x–y and x–z")
    page.get_by_role("button", name="Create the figure").click()
    expect(page.get_by_text("24 volumes with 2 planes each are 48")).to_be_visible()
    expect(page.get_by_label("Volumes", exact=True)).to_be_focused()


def test_commands_undo_the_same_motion_and_quote_names(chromium, service):
    of = {"id": "r2", "scan_id": "s1", "frame": None, "align": True, "motion": True, "parameters": {}}
    fluence = {"model": "uniform", "scattering_power": 1.3}
    blood = ["oxyhaemoglobin", "deoxyhaemoglobin"]
    unmixing = {"chromophores": [*blood, "my dye"], "fluence": fluence, "significance": 6, "non_negative": True}
    maps = {"id": "r3", "reconstruction_id": "r2", "scan_id": "s1", "unmixing": unmixing}
    script = """return [m.shellCommand("http://here", given.of, []), m.curlCommand("http://here", given.of),
        m.shellCommand("http://here", given.maps, []), m.isUnmixingCommandComplete(given.maps.unmixing),
        m.isUnmixingCommandComplete({...given.maps.unmixing, chromophores: ["oxyhaemoglobin"]}),
        m.isUnmixingCommandComplete({...given.maps.unmixing, non_negative: false})];"""
    with modules_of(chromium, service) as modules:
        shell, curl, unmix, *complete = modules.call("reconstructions/command.js", script, of=of, maps=maps)
    assert re.search(r"--align\s+\\\n\s+--motion", shell)
    assert '"align":true,"motion":true' in curl
    assert "--chromophore 'my dye'" in unmix
    assert complete == [True, False, False]
