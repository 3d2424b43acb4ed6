"""Design: what a form says comes from the service, and nothing is stored before one asks."""

import re

import httpx
import pytest
from playwright.sync_api import expect

from steradian.storage.db.database import Database, metadata_url
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository
from support.views import number_in
from support.waiting import until

FIELD = "#field-{}"
SMALL = "?mask=equi-steradian&count=60"


def ready(page):
    expect(page.get_by_role("button", name="Scan this")).to_be_enabled()
    return page


AT_REST = """(thing) => new Promise((done) => { let before = null; const look = () => {
  const { x, y, width, height } = thing.getBoundingClientRect(), now = [x, y, width, height].join();
  if (now === before) done(); else { before = now; setTimeout(look, 500); } }; look(); })"""
"""The layout moves for as long as what is beside a thing comes."""


def figure(page, name):
    return page.locator("dl.figures div", has=page.get_by_text(name, exact=True)).locator("dd").inner_text()


def stored(service):
    return [service.get(f"/{noun}").json()["items"] for noun in ("masks", "plans", "scans")]


def test_design_preview_shows_service_figures_and_stores_nothing(service, open_page):
    before = stored(service)
    page = ready(open_page(service, f"/design{SMALL}&pulse_rate=10"))
    mask = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 60}
    told = service.http.post("/designs/preview", json={"arrangement": mask, "pulse_rate": 10}).json()
    assert figure(page, "Points") == str(told["mask"]["count"])
    assert figure(page, "Visible edges") == f"{100 * told['visible_share']:.0f}\N{NO-BREAK SPACE}%"
    assert page.locator(".part.limiting").inner_text().startswith(told["plan"]["limiting"])
    expect(page.locator("section.spread")).to_contain_text("Sphere of 150")
    expect(page.get_by_text("53 points; requested: 60")).to_be_visible()
    page.locator(FIELD.format("count")).fill("200")
    until(lambda: figure(page, "Points") not in {"53", ""})
    assert stored(service) == before


def test_design_error_is_shown_beside_its_field(service, open_page):
    page = ready(open_page(service, f"/design{SMALL}"))
    page.locator(FIELD.format("depth")).fill("-1")
    expect(page.locator("#remarks-depth")).to_contain_text("allowed: > 0 mm")
    expect(page.locator(FIELD.format("depth"))).to_have_attribute("aria-invalid", "true")
    expect(page.get_by_role("button", name="Scan this")).to_be_disabled()
    page.locator(FIELD.format("depth")).fill("3.6")
    ready(page)
    page.locator(FIELD.format("aperture")).fill("30")
    expect(page.locator(".form .remarks .fault").first).to_be_visible()  # the scanner cannot go so far
    expect(page.get_by_role("button", name="Scan this")).to_be_disabled()
    page.provoked("status of 422")  # what is refused


def test_arrangement_change_keeps_points_and_aperture(service, open_page):
    """A grid fills the aperture with about as many points, and the number asked for before comes back."""
    page = ready(open_page(service, f"/design{SMALL}&aperture=0.01"))
    page.get_by_label("Arrangement").select_option("grid")
    until(lambda: figure(page, "Points") == "64")
    ready(page)
    assert [page.locator(FIELD.format(name)).input_value() for name in ("aperture", "side", "interval")] == [
        "10",
        "8",
        "1250",
    ]
    page.locator(FIELD.format("side")).fill("10")
    expect(page.locator(FIELD.format("interval"))).to_have_value("1000")
    page.locator(FIELD.format("side")).fill("8")
    page.get_by_label("Arrangement").select_option("combined")
    assert [page.locator(FIELD.format(name)).input_value() for name in ("count", "count2")] == ["30", "30"]
    page.get_by_label("Arrangement").select_option("hexagonal")
    expect(page.locator(FIELD.format("count"))).to_have_value("60")
    ready(page)


def test_refused_design_hides_figures_and_names_range_in_unit_of_field(service, open_page):
    """The largest interval of 8 points over 13.56 mm, 1.695 mm, is given in µm, the unit of its field."""
    page = ready(open_page(service, "/design?mask=grid&side=8&interval=0.001"))
    expect(page.locator("section.spread canvas")).to_be_visible()
    page.locator(FIELD.format("interval")).fill("1700")
    expect(page.locator("#remarks-interval")).to_have_text("allowed: at most aperture / count = 1695 µm")
    expect(page.locator("section.plane .refusal")).to_contain_text("Interval: allowed at most")
    for shown in ("dl.figures.across", "section.plane canvas", "section.spread canvas", "section.time .part"):
        expect(page.locator(shown).first).to_be_hidden()
    page.locator(FIELD.format("interval")).fill("1690")
    ready(page)
    expect(page.locator("section.plane canvas")).to_be_visible()
    assert figure(page, "Spacing") == "1.69\N{NO-BREAK SPACE}mm"
    page.provoked("status of 422")  # what is refused


def test_design_recovers_from_lost_preview_and_dims_what_is_old(service, open_page):
    """Until the service answers, the figures of the design before are dimmed and the scan cannot be started."""
    page = ready(open_page(service, f"/design{SMALL}"))
    dimmed = page.locator("#design[data-outcome=stale]")
    expect(dimmed).to_have_count(0)
    page.route("**/designs/preview", lambda route: route.abort())
    page.locator(FIELD.format("count")).fill("200")
    expect(page.locator("footer [role=alert]")).to_contain_text("the service does not answer")
    expect(dimmed).to_have_count(1)
    expect(page.get_by_role("button", name="Scan this")).to_be_disabled()
    page.unroute_all()
    ready(page)  # by itself
    expect(dimmed).to_have_count(0)
    assert figure(page, "Points") not in {"53", ""}
    page.provoked("net::ERR_FAILED")  # the answer that was lost


def test_the_point_goes_where_it_is_dragged(service, open_page):
    page = ready(open_page(service, f"/design{SMALL}"))
    canvas = page.locator("section.plane canvas")
    canvas.evaluate(AT_REST)
    box = canvas.bounding_box()
    x, y = box["x"] + box["width"] / 2 + 40, box["y"] + box["height"] / 2 - 25
    page.mouse.move(x - 40, y + 25)
    page.mouse.down()
    page.mouse.move(x, y, steps=4)
    ready(page)  # what is beside it has another height for another design
    canvas.evaluate(AT_REST)
    box = canvas.bounding_box()
    page.mouse.up()
    per = 13.56 * 1.04 / (min(box["width"], box["height"]) - 52)  # mm of a pixel: the frame is drawn 26 pixels inside
    moved = (x - box["x"] - box["width"] / 2, box["y"] + box["height"] / 2 - y)
    assert [number_in(page.locator(FIELD.format(name))) for name in "xy"] == [
        pytest.approx(per * one, abs=1.1 * per) for one in moved
    ]
    canvas.press("ArrowLeft")
    ready(page)
    offset = [number_in(page.locator(FIELD.format(name))) for name in "xy"]
    expect(page).to_have_url(re.compile(r"[?&]x="))
    page.reload()
    ready(page)
    assert [number_in(page.locator(FIELD.format(name))) for name in "xy"] == offset


@pytest.mark.parametrize(
    "arrangement",
    [
        *("combined", "grid", "poisson-disc"),
        *(pytest.param(name, marks=pytest.mark.nightly) for name in ("hexagonal", "random", "equiangular")),
    ],
)
def test_every_arrangement_can_be_looked_at(service, open_page, arrangement):
    page = open_page(service, f"/design{SMALL}")
    page.get_by_label("Arrangement").select_option(arrangement)
    if arrangement == "grid":
        page.locator(FIELD.format("side")).fill("9")
    ready(page)
    assert int(figure(page, "Points").replace(",", "")) > 20
    page.get_by_label("Evaluate another point").check()
    ready(page)
    expect(page).to_have_url(re.compile(r"[?&]look="))


def test_design_error_of_second_point_is_shown_beside_its_field(service, open_page):
    page = ready(open_page(service, "/design?mask=combined&count=60&count2=60"))
    page.locator(FIELD.format("x2")).fill("9")
    expect(page.locator("#remarks-x2")).to_contain_text("over the aperture")
    page.locator(FIELD.format("x2")).fill("2")
    ready(page)
    page.provoked("status of 422")  # what is refused


def test_any_number_of_points_of_interest(service, open_page):
    """A third is added and counted by the service, comes back from the address, is refused beside it, and moves up."""
    page = ready(open_page(service, "/design?mask=combined&count=60&count2=60"))
    page.get_by_role("button", name="Add a point of interest").click()
    for name, value in {"count3": "80", "depth3": "2.5", "x3": "-2", "y3": "1"}.items():
        page.locator(FIELD.format(name)).fill(value)
    ready(page)
    points = [(3.6e-3, 60, [0, 0]), (3.6e-3, 60, [3e-3, 0]), (2.5e-3, 80, [-2e-3, 1e-3])]
    points = [dict(zip(("depth", "count", "offset"), one, strict=True)) for one in points]
    mask = {"arrangement": "combined", "aperture": 13.56e-3, "points_of_interest": points}
    told = service.http.post("/designs/preview", json={"arrangement": mask}).json()
    assert figure(page, "Points") == str(told["mask"]["count"])
    expect(page).to_have_url(re.compile("y3=0.001"))
    page.reload()
    ready(page)
    expect(page.locator(FIELD.format("depth3"))).to_have_value("2.5")
    page.locator(FIELD.format("x3")).fill("9")
    expect(page.locator("#remarks-x3")).to_contain_text("over the aperture")
    page.get_by_role("button", name="Remove point 2").click()
    expect(page.locator(FIELD.format("x2"))).to_have_value("9")
    expect(page.locator(FIELD.format("x3"))).to_have_count(0)
    page.provoked("status of 422")  # what is refused


def test_design_form_offers_every_plan_field_of_api(service, open_page):
    """Every field of the request (wavelengths by their map); in the units of a person, and stored in the API's."""
    page = ready(open_page(service, f"/design{SMALL}&pulse_rate=200"))
    schema = httpx.get(f"{service.url}/openapi.json").json()["components"]["schemas"]["DesignRequest"]
    for name in set(schema["properties"]) - {"arrangement", "point", "wavelengths"}:
        expect(page.locator(f"#field-{name}, [data-field^='{name}.']").first).to_be_attached()
    page.locator("[data-group='More'] summary").click()
    page.locator(FIELD.format("excitation")).fill("750, 5000")
    expect(page.locator("[data-field='excitation'] .remarks")).to_contain_text("200 to 3000 nm")
    page.locator(FIELD.format("excitation")).fill("750, 850")
    page.locator(FIELD.format("beams")).fill("0, 0; 1, 0")
    ready(page)
    mask = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 60}
    told = service.http.post("/designs/preview", json={"arrangement": mask, "beams": [[0, 0], [1e-3, 0]]}).json()
    until(lambda: figure(page, "Points") == str(told["mask"]["count"]))
    expect(page).to_have_url(re.compile("more=.*beams"))
    page.reload()
    expect(page.locator(FIELD.format("beams"))).to_have_value("0, 0; 1, 0")
    page.locator(FIELD.format("beams")).fill("")
    ready(page)
    page.get_by_label("Live image").uncheck()
    page.get_by_role("button", name="Scan this").click()
    expect(page).to_have_url(re.compile("/scans/s"))
    scan = service.get(f"/scans/{page.url.rpartition('/')[2]}").json()
    plan = service.get(f"/plans/{scan['plan_id']}").json()
    assert plan["excitation"] == pytest.approx([750e-9, 850e-9])
    assert plan["beams"] == []
    until(lambda: service.get(f"/scans/{scan['id']}").json()["state"] == "complete")
    expect(page.get_by_label("Frame")).to_contain_text("750 nm")
    page.goto(f"{service.url}/scans")
    expect(page.locator("tbody tr").first).to_contain_text("750, 850\N{NO-BREAK SPACE}nm")
    page.provoked("status of 422")  # what is refused


def test_a_tuning_map_is_read_from_a_file(service, open_page):
    """Points are visited by its wavelengths, in the time that the service tells; a line that is wrong is named."""
    page = ready(open_page(service, f"/design{SMALL}"))
    places = [(x, y, 1550 + 0.1 * x) for x in (-6, 0, 6) for y in (-6, 0, 6)]
    rows = ["x_mm,y_mm,wavelength_nm", *(",".join(map(str, place)) for place in places)]
    wrong = page.locator(".tuning .fault")
    for name, lines, fault in (
        ("map.csv", [*rows, "1,2"], "map.csv: line 11"),
        ("map.json", ['{"places": []}'], "positions and wavelengths"),
    ):
        page.set_input_files("#field-tuning_map", file_of(name, lines))
        expect(wrong).to_contain_text(fault)
        ready(page)  # what the service says of the design without a map does not wipe it away
        expect(wrong).to_contain_text(fault)
    page.set_input_files("#field-tuning_map", file_of("map.csv", rows))
    expect(page.locator(".tuning")).to_contain_text("9 positions")
    expect(wrong).to_have_count(0)
    page.locator(FIELD.format("order")).select_option("wavelength")
    ready(page)
    mask = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 60}
    tuning = {"positions": [[1e-3 * x, 1e-3 * y] for x, y, _ in places], "wavelengths": [1e-9 * w for *_, w in places]}
    body = {"arrangement": mask, "order": "wavelength", "tuning_map": tuning}
    seconds = service.http.post("/designs/preview", json=body).json()["plan"]["total_seconds"]
    assert figure(page, "Scan") == duration(seconds)


def file_of(name, lines):
    return {"name": name, "mimeType": "text/csv", "buffer": "\n".join(lines).encode()}


def duration(seconds):
    """As the page writes some tens of seconds, or less than ten."""
    return f"{float(f'{seconds:.2g}') if seconds < 10 else round(seconds):g}\N{NO-BREAK SPACE}s"


def test_designs_are_pinned_side_by_side(service, open_page):
    """A pinned design keeps its figures while the form goes on, is in the address, and can be worked on again."""
    page = ready(open_page(service, f"/design{SMALL}&label=%3Cb%3Efirst"))
    first = page.locator("dl.figures.across").inner_text().split("\n")
    page.get_by_role("button", name="Pin this design").click()
    expect(page.locator(".pin dl.figures")).to_contain_text("Sphere of 150")
    page.get_by_label("Arrangement").select_option("random")
    ready(page)
    page.get_by_role("button", name="Pin this design").click()
    expect(page.locator(".pin dl.figures")).to_have_count(2)
    expect(page).to_have_url(re.compile(r"pin=.*pin="))
    page.reload()
    expect(page.locator(".pin dl.figures")).to_have_count(2)
    expect(page.locator(".pin h3")).to_have_text(["Equi-steradian, <b>first", "Random, <b>first"])
    kept = page.locator(".pin dl.figures").first.inner_text().split("\n")
    assert set(first) <= set(kept)
    page.get_by_role("button", name="Unpin Random").click()
    expect(page.locator(".pin")).to_have_count(1)
    page.get_by_role("link", name="Edit this design").click()
    ready(page)
    assert page.get_by_label("Arrangement").input_value() == "equi-steradian"


def test_an_answer_that_is_lost_on_its_way_makes_no_second_scan(service, open_page):
    """Who sees that it failed presses again."""
    page = ready(open_page(service, f"/design{SMALL}&pulse_rate=200"))
    scans = {scan["id"] for scan in service.get("/scans").json()["items"]}

    def lose(route):
        if route.request.method != "POST":
            return route.continue_()
        route.fetch()
        return route.abort()

    page.route("**/api/v1/scans", lose)
    button = page.get_by_role("button", name="Scan this")
    with page.expect_event("requestfailed"):
        button.click()
    page.unroute_all()
    button.click()
    expect(page).to_have_url(re.compile("/scans/s"))
    (made,) = {scan["id"] for scan in service.get("/scans").json()["items"]} - scans
    assert page.url.endswith(made)
    page.provoked("net::ERR_FAILED")  # the answer that was lost


def test_where_there_are_several_scanners_a_person_chooses_one(service, open_page):
    page = ready(open_page(service, f"/design{SMALL}&pulse_rate=200"))
    expect(page.get_by_label("Scanner for this scan", exact=True)).to_be_hidden()
    database = Database(metadata_url(service.settings))
    other = ScannerRepository(database, scanner_id="scanner-1")
    other.ensure(simulated=True)
    try:
        choice = page.get_by_label("Scanner for this scan", exact=True)
        expect(choice).to_be_visible()
        before = stored(service)
        page.get_by_role("button", name="Scan this").click()
        expect(page.locator("footer [role=alert]")).to_contain_text("select the scanner")
        assert stored(service) == before
        choice.select_option("scanner-1")
        page.get_by_role("button", name="Scan this").click()
        expect(page).to_have_url(re.compile("/scans/s"))
        made = page.url.rpartition("/")[2]
        assert service.get(f"/scans/{made}").json()["scanner_id"] == "scanner-1"
    finally:
        service.http.delete("/scanners/scanner-1", params={"abandon": True}).raise_for_status()
        database.close()


def test_a_pulse_budget_is_proposed_and_its_split_taken_by_keyboard_and_pointer(service, open_page):
    """The chosen split fills in points and averages; its figures are the service's."""
    page = ready(open_page(service, "/design?mask=grid&side=9&aperture=0.005&depth=0.0015&interval=0.0005"))
    panel = page.get_by_role("region", name="Pulse budget")
    for label, value in {"Time (min)": "0.4", "Signal-to-noise of one pulse (dB)": "25"}.items():
        panel.get_by_label(label).fill(value)
    panel.get_by_role("button", name="Propose").click()
    slider = panel.get_by_role("slider", name="Points of the scan")
    expect(panel.get_by_text("1,200 pulses of 25.0 dB")).to_be_visible()
    proposed = panel.locator(".caption[aria-live]")
    expect(proposed).to_contain_text("; proposed")
    state = panel.get_by_role("status").last
    expect(state).to_have_text("Not in the design yet: figures above and Scan this are of the form.")
    slider.focus()
    page.keyboard.press("End")
    expect(proposed).to_contain_text("1,156 points × 1 average,")
    expect(page.locator(FIELD.format("side"))).to_have_value("34")
    expect(state).to_have_text("The design has these points.")
    expect(page.locator(FIELD.format("averages"))).to_have_value("1")
    page.keyboard.press("ArrowLeft")
    expect(page.locator(FIELD.format("averages"))).to_have_value("2")
    box = panel.locator("svg.trade").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + 2, box["y"] + box["height"] / 2, steps=3)
    page.mouse.up()
    expect(slider).to_have_attribute("aria-valuenow", "0")
    assert int(page.locator(FIELD.format("averages")).input_value()) > 10
    ready(page)
    page.locator(FIELD.format("depth")).fill("1.6")
    panel.get_by_role("button", name=re.compile("^Use [0-9]")).click()
    expect(panel).to_contain_text("The design has changed since: propose again.")
    ready(page)
