"""Data: a recording of one's own becomes a scan; what its file does not say is asked for."""

import numpy as np
import pytest
from playwright.sync_api import expect

import steradian
from steradian.scans.importing.description import Description
from support.waiting import until


@pytest.fixture
def recording(tmp_path):
    """A ball 3 mm above a grid of 144 sensors, 512 samples of 20 ns, with its positions in mm beside it."""
    x = np.arange(12) * 1e-3 - 5.5e-3
    places = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    distance = np.hypot(np.linalg.norm(places, axis=1), 3e-3)[:, None]
    way = distance - np.arange(512) * 20e-9 * 1500
    np.save(tmp_path / "<b>ball.npy", (1e7 * way * np.exp(-((way / 1e-4) ** 2))).astype(np.int16))
    np.savetxt(tmp_path / "places.csv", 1e3 * places, delimiter=",", header="x,y", comments="")
    return [tmp_path / "<b>ball.npy", tmp_path / "places.csv"]


def test_uploaded_recording_is_inspected_and_imported_as_scan(service, open_page, recording):
    before = service.get("/scans").json()["items"]
    page = open_page(service, "/data")
    page.set_input_files("#files", recording)
    expect(page.get_by_text("<b>ball.npy", exact=True)).to_be_visible()
    figures = page.locator("dl.figures")
    expect(figures).to_contain_text("512 (int16)")
    expect(page.locator("[data-remark=sampling_interval]")).to_contain_text(
        "Required: more than 0 ns; not stated in the file"
    )
    expect(page.locator("[data-remark=sound_speed]")).to_contain_text("1500 is an assumption")
    expect(page.get_by_role("button", name="Import")).to_be_disabled()
    expect(page.locator("#not-yet")).to_have_text("Required for the import: sampling interval.")
    box = page.get_by_role("button", name="Import").bounding_box()
    assert box["y"] + box["height"] <= page.viewport_size["height"], "in sight, with all fields of two files open"
    assert drawn(page) > 144  # the sensors, before anything is stored
    expect(page.locator(".chart canvas").first).to_be_visible()
    page.get_by_label("Sampling interval").fill("20")
    page.get_by_label("Aperture").fill("12")
    expect(figures).to_contain_text("20\N{NO-BREAK SPACE}ns (50\N{NO-BREAK SPACE}MHz)")
    expect(figures).to_contain_text("12.00\N{NO-BREAK SPACE}mm")
    expect(page.locator("#not-yet")).to_be_empty()
    assert service.get("/scans").json()["items"] == before
    page.route("**/api/v1/jobs", lambda route: route.fulfill(status=503, json={"detail": "full for now"}))
    page.get_by_role("button", name="Import").click()
    expect(page.locator(".remarks")).to_contain_text(["full for now"])
    page.unroute_all()
    page.provoked("status of 503")
    page.get_by_role("button", name="Import").click()
    expect(page.get_by_text("Imported")).to_be_visible()
    page.get_by_role("button", name="Reconstruct").click()
    page.wait_for_url("**/reconstructions/r*")
    made = page.url.rpartition("/")[2]
    until(lambda: service.get(f"/reconstructions/{made}").json()["state"] == "succeeded")
    scan = service.get(f"/reconstructions/{made}").json()["scan_id"]
    assert service.get(f"/scans/{scan}").json()["labels"]["file"] == "<b>ball.npy"
    assert service.get(f"/scans/{scan}").json()["summary"]["stored"] == 144


def test_depths_of_a_record_that_begins_late_are_shown(service, open_page, tmp_path):
    x = np.arange(12) * 1e-3 - 5.5e-3
    places = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    traces = np.zeros((144, 151), np.float32)
    np.savez(tmp_path / "late.npz", traces=traces, positions=places, dt=20e-9, c=1500.0, t0=np.full((1, 144), 3e-6))
    page = open_page(service, "/data")
    page.set_input_files("#files", [tmp_path / "late.npz"])
    expect(page.locator("dl.figures")).to_contain_text("4.5\N{NO-BREAK SPACE}mm to 9.0\N{NO-BREAK SPACE}mm")


def test_late_response_of_replaced_upload_is_ignored(service, open_page, recording):
    """A file that is still on its way when others are dropped changes nothing once it is there."""
    page, held = open_page(service, "/data"), []
    page.route("**/api/v1/uploads", lambda route: route.continue_() if held else held.append(route))
    page.set_input_files("#files", recording[1])
    until(lambda: page.evaluate("1") and held)
    page.set_input_files("#files", recording)
    page.get_by_label("Sampling interval").fill("20")
    expect(page.get_by_role("button", name="Import")).to_be_enabled()
    with page.expect_response("**/api/v1/uploads") as late:
        held[0].continue_()
    late.value.finished()
    with page.expect_response("**/preview"):
        page.get_by_label("Aperture").fill("12")
    expect(page.get_by_label("Sampling interval")).to_have_value("20")


def test_no_line_lies_under_the_legend(service, open_page, recording):
    """The names of the A-lines stand beneath the chart, and switch their lines off and on."""
    page = open_page(service, "/data")
    page.set_input_files("#files", recording)
    page.locator(".chart canvas").first.wait_for()

    def boxes():
        return [page.locator(one).first.bounding_box() for one in (".chart", ".chart canvas", ".chart .legend")]

    def are_apart():
        (top, chart), (above, plot), (beneath, legend) = ((box["y"], box["height"]) for box in boxes())
        return plot > 200 and above + plot <= beneath and beneath + legend <= top + chart + 1

    until(are_apart, tell=boxes)  # what is above may still come, and move them between two looks
    picture = page.locator(".chart canvas")
    shown = picture.evaluate("canvas => canvas.toDataURL()")
    button = page.get_by_role("button", name="A-line 0", exact=True)
    button.click()
    expect(button).to_have_attribute("aria-pressed", "false")
    until(lambda: picture.evaluate("canvas => canvas.toDataURL()") != shown)
    button.click()
    until(lambda: picture.evaluate("canvas => canvas.toDataURL()") == shown)


def test_import_form_with_grid_pitch_places_sensors(service, open_page, recording):
    """Nobody says where 144 sensors are: with a pitch they are a square, centred."""
    page = open_page(service, "/data")
    page.set_input_files("#files", recording[0])
    expect(page.get_by_text("Sensor positions are not stated")).to_be_visible()
    expect(page.locator("[data-remark=interval]")).to_contain_text("Required: positions or a grid")
    page.get_by_label("Sampling interval").fill("20")
    page.get_by_label("Grid pitch").fill("1")
    expect(page.get_by_text("Sensor positions are not stated")).to_be_hidden()
    expect(page.get_by_role("button", name="Import")).to_be_enabled()
    assert drawn(page) > 144
    page.provoked("status of 422")  # the array alone does not say how many are on a side


def test_import_form_has_field_for_each_value_of_description(service, open_page, tmp_path):
    """The page lists arrays under names of their own, and reads the one that is named, in the unit that is stated."""
    x = np.arange(12) * 1e-3 - 5.5e-3
    places = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    lines = np.random.default_rng(3).normal(size=(144, 100)).astype(np.float32)
    np.savez(tmp_path / "own.npz", signals=lines, spare=lines, positions=1e3 * places, dt=0.02, c=1500.0)
    page = open_page(service, "/data")
    page.set_input_files("#files", tmp_path / "own.npz")
    remark = page.locator("[data-remark=array]")
    expect(remark).to_have_text("Required: one of c, dt, positions, signals, spare")
    names = set(page.locator("form [name]").evaluate_all("all => all.map((one) => one.name)"))
    not_numbers = {"positions", "weights", "file_name"}  # arrays, and the name of the file
    assert set(Description.model_fields) - not_numbers - {"grid"} <= names
    page.get_by_label("Array of the A-lines").fill("signals")
    page.get_by_text("units of the file, scale").click()
    page.get_by_label("Lengths in the file").select_option("mm")
    page.get_by_label("Times in the file").select_option("us")
    page.get_by_label("Scale").fill("2")
    figures = page.locator("dl.figures")
    expect(figures).to_contain_text("20\N{NO-BREAK SPACE}ns (50\N{NO-BREAK SPACE}MHz)")
    expect(remark).to_be_empty()
    page.get_by_label("Sensors along x").fill("12")
    expect(page.locator("[data-remark=interval]")).to_contain_text("Required: with a pitch along y or")
    expect(page.get_by_role("button", name="Import")).to_be_disabled()
    page.get_by_label("Sensors along x").fill("")
    expect(page.locator("[data-remark=interval]")).to_be_empty()
    page.get_by_role("button", name="Import").click()
    expect(page.get_by_text("Imported")).to_be_visible()
    scan = page.get_by_text("Imported").locator("xpath=..").locator("a").get_attribute("href").rpartition("/")[2]
    file = tmp_path / "scan.h5"
    file.write_bytes(service.get(f"/scans/{scan}/file").content)
    held = steradian.open(file).recording()
    np.testing.assert_allclose(held.traces * np.reshape(held.scale, (-1, 1)), 2 * lines, rtol=1e-6)
    page.provoked("status of 422")  # the array was not named


def drawn(page):
    """Pixels of the picture of the sensors that have the colour of sensors."""
    return page.locator(".stage canvas").evaluate(
        "canvas => { const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);"
        " let n = 0; for (let k = 0; k < data.length; k += 4) n += Number(data[k + 2] > 200 && data[k] < 160);"
        " return n; }"
    )
