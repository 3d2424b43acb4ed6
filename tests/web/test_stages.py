"""Scans in stages on the page: a survey, the choice of its point of interest, the focus; and a scan around a place."""

import re
from contextlib import contextmanager

import numpy as np
import pytest
from playwright.sync_api import expect

from fabry_perot.simulator import launch
from support.page_modules import modules_of
from support.services import Service
from support.views import drawn, number_in
from support.waiting import until

BALLS = ((1.0, -0.8, 1.6), (-1.2, 0.9, 2.4))
"""x, y and depth in mm of what the scanner sees, the brighter first."""
SIDE = 6.0
DESIGN = (
    f"mask=equi-steradian&aperture={SIDE / 1e3}&depth=0.002&count=130&samples=400&sampling_interval=1.6e-8"
    "&survey=focus&survey_points=60"
)
FAST, WATCHED = {"pulse_rate": 100}, {"pulse_rate": 1, "averages": 3}
"""Of a scanner that is twenty times as fast; seven A-lines a second can be watched."""


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """A service on a scanner that sees two balls, 20 times faster than real."""
    folder = tmp_path_factory.mktemp("stages")
    phantom = folder / "balls.npz"
    np.savez(phantom, centres=1e-3 * np.array(BALLS), sigmas=[1.5e-4, 1.5e-4], amplitudes=[1.0, 0.7])
    with launch(tcp="127.0.0.1:0", phantom=str(phantom), speed=20, noise_db=40) as scanner:
        service = Service(folder / "data", log=folder / "log", scanner=scanner.url).start()
        yield service
        service.close()


def begin(page, service, **parameters):
    """Begin a scan in stages from the design page; returns its identifier."""
    page.goto(f"{service.url}/design?{DESIGN}&" + "&".join(f"{name}={value}" for name, value in parameters.items()))
    button = page.get_by_role("button", name="Scan this")
    expect(button).to_be_enabled()
    button.click()
    expect(page).to_have_url(re.compile("/scans/s"))
    return page.url.rpartition("/")[2]


def stages(service, scan):
    return service.get(f"/scans/{scan}").json()["stages"]


def is_complete(service, scan):
    return service.get(f"/scans/{scan}").json()["state"] == "complete"


@contextmanager
def paused(service, scan, points):
    """Pause a scan as soon as it has so many points: the image of a part of it is made however busy the machine is."""
    until(lambda: service.get(f"/scans/{scan}").json()["progress"]["done"] >= points)
    service.http.put(f"/scans/{scan}/desired-state", json={"state": "paused"}).raise_for_status()
    yield
    service.http.put(f"/scans/{scan}/desired-state", json={"state": "running"}).raise_for_status()


def chosen_place(page):
    return [number_in(page.locator(f"#place-{axis}")) for axis in ("x", "y", "depth")]


def click_at(page, x, y):
    """Click a place in mm of the live image, which shows the aperture."""
    box = page.locator(".markers").bounding_box()
    page.mouse.click(box["x"] + box["width"] * (0.5 + x / SIDE), box["y"] + box["height"] * (0.5 - y / SIDE))


def test_place_chosen_by_click_on_growing_image_is_focused(service, open_page):
    page = open_page(service, "/scans")
    seen = []
    page.on("response", lambda one: seen.append(one) if one.status == 200 and one.url.endswith("/revision") else None)
    scan = begin(page, service, **WATCHED, decision="ask", choice="several")
    choice = page.locator(".stage-choice")
    with paused(service, scan, points=10):
        expect(page.locator("section.image .caption", has_text="revision")).to_be_visible()
    expect(choice).to_contain_text("The laser is off: choose the point of interest")
    assert service.get("/scanners/scanner-0").json()["laser"] == "off"
    expect(page.locator("section.head strong")).to_have_text("waiting for a point of interest")
    expect(page.locator("[data-filter=stored]")).to_have_text("stored 60")
    expect(page.locator("section.image")).to_contain_text("from 60 of 60 A-lines")
    expect(choice.locator("tbody tr")).to_have_count(2)
    expect(page.locator("[data-marker=proposal]")).to_have_count(2)
    assert chosen_place(page) == pytest.approx(BALLS[0], abs=0.15)
    expect(page.locator("section.image .scale-bar")).to_be_visible()
    assert page.locator(".stage-choice button").count() == 4
    for button in page.locator(".stage-choice button").all():
        expect(button).to_contain_text("(laser on)")
    expect(choice.locator("button.primary")).to_have_text("Focus here (laser on)")
    expect(choice).to_contain_text("Accept and Focus here start the focus at once: the laser goes on.")
    expect(page.locator("#place-y")).to_have_value(re.compile("^−0"))
    x, y, depth = BALLS[1]
    click_at(page, x + 0.2, y - 0.25)
    expect(choice).to_contain_text("estimated from the projections")
    place = chosen_place(page)
    assert place == pytest.approx([x + 0.2, y - 0.25, depth], abs=0.15)
    page.locator("#place-depth").fill("99")
    page.get_by_role("button", name="Focus here").click()
    expect(choice.get_by_role("alert")).to_contain_text("a depth of 0.099")
    page.locator("#place-depth").fill(str(place[2]))
    page.get_by_role("button", name="Focus here").click()
    expect(choice).to_be_hidden()
    expect(page.locator(".stage-list")).to_be_focused()
    expect(page.locator("[data-filter=missing]")).not_to_have_text("missing 0")  # the points of the focus are shown
    with paused(service, scan, points=65):
        of_focus = re.compile(r"revision \d+, from (6[1-9]|[7-9]\d|1\d\d) of")
        expect(page.locator("section.image")).to_contain_text(of_focus)
    until(lambda: page.evaluate("1") and is_complete(service, scan))
    survey, focus = stages(service, scan)
    assert (survey["state"], focus["state"], focus["decided_by"]) == ("made", "made", "local")
    assert np.ravel(focus["points_of_interest"]) == pytest.approx(1e-3 * np.array(place))
    count = 60 + focus["points"]
    expect(page.locator("[data-filter=stored]")).to_have_text(f"stored {count}")
    expect(page.locator(".stage-list")).to_contain_text(f"Focus: {focus['points']} points measured; around x −1.0")
    expect(page.locator("section.image")).to_contain_text(f"the complete image from {count} A-lines")
    revisions = [one.json() for one in seen]
    points = [one["points"] for one in revisions]
    assert points == sorted(points)
    assert any(one["points"] < 60 for one in revisions), "the image of the survey has grown"
    assert any(60 < one["points"] and not one["final"] for one in revisions), "and that of the focus"
    page.provoked("status of 422")  # the depth that is refused


def test_proposal_is_accepted_with_keys(service, open_page):
    page = open_page(service, "/scans")
    scan = begin(page, service, **FAST, decision="ask")
    expect(page.locator(".live-frame canvas")).to_be_visible()
    expect(page.locator(".stage-choice")).to_be_visible()
    markers = page.get_by_role("application", name="Point of interest on the live image")
    x = chosen_place(page)[0]
    markers.press("Shift+ArrowRight")
    assert chosen_place(page)[0] == pytest.approx(x + 0.05 * SIDE, abs=0.01)
    page.get_by_role("button", name="proposal 1").press("Enter")
    until(lambda: page.evaluate("1") and is_complete(service, scan))
    focus = stages(service, scan)[1]
    assert focus["points_of_interest"] == [focus["proposals"][0]["position"]]
    expect(page.locator(".stage-list")).to_contain_text("points measured; around x 1.0")


def test_scan_without_proposal_is_ended_by_person(service, open_page):
    page = open_page(service, "/scans")

    def without_proposals(route):
        answer = route.fetch()
        scan = answer.json()
        for stage in scan["stages"][1:]:
            stage |= {"proposals": [], "decision": "auto"}
        route.fulfill(response=answer, json=scan)

    page.route(re.compile(r"/api/v1/scans/s\w+$"), without_proposals)
    scan = begin(page, service, **FAST, decision="ask")
    expect(page.locator(".stage-choice")).to_contain_text("Nothing in the image of the survey stands out")
    expect(page.locator(".stage-choice tbody tr")).to_have_count(0)
    assert chosen_place(page) == [0, 0, 2]  # of the mask
    page.get_by_role("button", name="Stop …").click()
    expect(page.get_by_role("dialog")).to_contain_text(
        "Stop keeps the 60 A-lines for reconstruction, without the focus"
    )
    page.get_by_role("button", name="Stop and keep").click()
    until(lambda: page.evaluate("1") and service.get(f"/scans/{scan}").json()["state"] == "partial")
    expect(page.locator(".stage-list")).to_contain_text("Focus: not measured")
    expect(page.locator(".stage-choice")).to_be_hidden()
    page.unroute_all(behavior="wait")


def test_design_shows_range_of_time_and_points_of_stages(service, open_page):
    page = open_page(service, "/design?mask=equi-steradian&count=130&aperture=0.006&depth=0.002&pulse_rate=1")
    page.get_by_label("Measure", exact=True).select_option("focus")
    expect(page.get_by_label("Measure", exact=True)).to_be_focused()
    page.locator("#field-survey_points").fill("400")
    expect(page.locator("#remarks-survey_points")).to_contain_text("16 to 1")
    page.locator("#field-survey_points").fill("60")
    page.get_by_label("Focus on").select_option("several")
    page.locator("#field-focus_places").fill("3")
    page.get_by_label("Place chosen").select_option("ask")
    page.get_by_label("End early").select_option("change")
    expect(page.get_by_role("button", name="Scan this")).to_be_enabled()
    mask = {"arrangement": "equi-steradian", "aperture": 6e-3, "depth": 2e-3, "count": 130}
    survey = {"points": 60, "choice": "several", "count": 3, "decision": "ask"}
    body = {"arrangement": mask, "pulse_rate": 1, "survey": survey, "order": "progressive"}
    body["stopping"] = {"max_gain": None, "max_change": 0.005}
    told = service.http.post("/designs/preview", json=body).raise_for_status().json()
    figures = page.locator("dl.figures.across")
    expect(figures).to_contain_text("60 + up to {}".format(told["stages"][1]))
    least, most = (told["plan"][name] for name in ("least_seconds", "total_seconds"))
    assert 0.4 * most < least < 0.6 * most
    expect(figures).to_contain_text(re.compile(r"(\d min )?\d+\ss to \d min \d+ s"))
    expect(page.locator("#field-order")).to_have_value("progressive")
    expect(page).to_have_url(re.compile("focus_places=3.*stopping=change"))  # the address follows a moment later
    page.reload()
    expect(page.locator("#field-focus_places")).to_have_value("3")
    expect(page.get_by_role("button", name="Scan this")).to_be_enabled()  # the request of the page itself is answered
    with page.expect_request("**/designs/preview") as request:
        page.get_by_label("Place chosen").select_option("auto")
    assert request.value.post_data_json["survey"] == survey | {"decision": "auto"}
    assert request.value.post_data_json["stopping"] == body["stopping"]
    page.provoked("status of 422")  # the number that is refused


def test_scan_here_opens_design_around_place_of_volume(service, open_page):
    mask = service.make("/masks", arrangement="equi-steradian", aperture=5e-3, depth=2e-3, count=60)
    plan = service.make("/plans", mask_id=mask["id"], samples=400, sampling_interval=1.6e-8, **FAST)
    scan = service.start_scan(plan["id"])["id"]
    until(lambda: is_complete(service, scan))
    volume = service.done("/reconstructions", scan_id=scan, parameters={"modes": 40})["id"]
    page = drawn(open_page(service, f"/volumes/{volume}#at=-1.2,0.9,2.4"))
    page.get_by_role("button", name="Scan here").click()
    expect(page.get_by_role("button", name="Scan this")).to_be_enabled()
    expect(page.locator("#arrangement")).to_have_value("equi-steradian")
    fields = {"aperture": 5, "x": -1.2, "y": 0.9, "depth": 2.4, "samples": 400, "sampling_interval": 16}
    assert {name: number_in(page.locator(f"#field-{name}")) for name in fields} == pytest.approx(fields)


def test_depth_of_maximum_is_found_in_projections(chromium, service):
    """Two objects in front of each other in the projection along x, below a bright near field."""
    grid = np.mgrid[0:30, 0:24, 0:50]
    volume = sum(
        height * np.exp(-sum((axis - at) ** 2 for axis, at in zip(grid, place, strict=True)) / (2 * 1.5**2))
        for height, place in ((1.0, (8, 12, 20)), (0.6, (20, 12, 33)))
    )
    volume += 0.9 * np.exp(-grid[2] / 2.0) + np.random.default_rng(1).normal(0, 0.01, volume.shape)
    along = {
        name: {"values": image.ravel(), "shape": image.shape, "origin": [1e-4, 1e-4], "spacing": [1e-4, 1e-4]}
        for name, image in (("x", volume.max(0)), ("y", volume.max(1)), ("z", volume[:, :, 10:].max(2)))
    }
    script = "return given.places.map((place) => m.depthAt(given.along, place));"
    places = [[1e-4 * (1 + at) for at in place] for place in ((8, 12), (20, 12), (21, 11))]
    with modules_of(chromium, service) as modules:
        found = modules.call("scan/depth_estimate.js", script, along=along, places=places)
    assert found == pytest.approx([21e-4, 34e-4, 34e-4], abs=1.1e-4)
