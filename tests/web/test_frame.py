"""What every page has: the stop that is always in reach, the scanner's pill, keys, themes, what others add."""

import re
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import expect
from sqlalchemy import delete

from steradian.storage.db.database import Database, metadata_url
from steradian.storage.db.tables import ScannerRow
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository
from steradian.web.pages import PAGES
from support.scanners import scanner_of
from support.services import Service
from support.waiting import until

ADDRESSES = [address.format(identifier="s01jz0000000000000000000000") for address in PAGES if "{" not in address]

DONE = re.compile("Emergency stop: (no scanner is connected|laser off)")
AT_REST = {"idle", "off"}
"""What comes of a stop while no scan runs: the built-in simulator was never started, or says so itself."""

DOCUMENT = Path(__file__).parents[2] / "docs" / "page.md"


@pytest.fixture
def released(service):
    """Leave the stop as it was found."""
    yield
    service.http.delete("/scanners/scanner-0/emergency-stop")


def laser(service):
    stop = service.get("/scanners/scanner-0").json()["emergency_stop"]
    return stop and stop["laser"]


def slow_scan(service):
    """A scan of minutes that has begun."""
    scan = service.start_scan(service.plan(pulse_rate=1, averages=24))
    until(lambda: service.get(f"/scans/{scan['id']}").json()["progress"]["done"] >= 1)
    return scan["id"]


@pytest.mark.parametrize("address", ADDRESSES)
def test_the_stop_is_in_reach_on_every_page(service, open_page, address):
    page = open_page(service, address)
    box = page.get_by_role("button", name="Emergency stop").bounding_box()
    assert min(box["width"], box["height"]) >= 44
    assert 0 <= box["x"] <= 1280 - box["width"]
    page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
    assert page.get_by_role("button", name="Emergency stop").bounding_box() == box


def test_no_view_violates_the_security_policy(service, open_page):
    """Every view with content: an inline style, script or foreign source would be reported."""
    scan = service.start_scan(service.plan(pulse_rate=50))["id"]
    until(lambda: service.get(f"/scans/{scan}").json()["state"] == "complete")
    made = service.http.post("/reconstructions", json={"scan_id": scan}).json()["id"]
    until(lambda: service.get(f"/reconstructions/{made}").json()["state"] == "succeeded")
    page = open_page(service, "/")
    page.context.add_init_script(
        "window.violations = []; document.addEventListener('securitypolicyviolation',"
        " (event) => window.violations.push(`${event.violatedDirective}: ${event.blockedURI} ${event.sourceFile}`))"
    )
    parts = {"/scans": scan, "/reconstructions": made, "/volumes": made}
    for address in PAGES:
        parent = address.partition("/{")[0]
        page.goto(service.url + address.format(identifier=parts.get(parent, "")))
        page.wait_for_load_state("networkidle" if parent == "/design" else "load")
        expect(page.locator("main")).not_to_be_empty()
        for summary in page.locator("main summary:visible").all():
            summary.click()
        page.wait_for_timeout(500)
        assert page.evaluate("window.violations") == [], address
        assert page.evaluate("document.querySelectorAll('style').length") == 0, address


def test_a_dialog_does_not_take_the_stop_away(service, open_page, released):
    page = open_page(service, "/scans")
    page.keyboard.press("?")
    expect(page.get_by_role("dialog")).to_be_visible()
    box = page.get_by_role("button", name="Emergency stop").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    expect(page.locator("#stopped")).to_contain_text(DONE)
    page.get_by_role("dialog").get_by_role("button", name="Close").click()
    page.get_by_role("button", name="Release …").click()  # and the answer is in reach, too
    expect(page.get_by_role("dialog")).to_contain_text("is it safe to fire the laser")
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)


@pytest.mark.parametrize("press", ["click", "key"])
def test_stop_button_switches_laser_off_and_shows_confirmation(service, open_page, released, press):
    scan = slow_scan(service)
    page = open_page(service, "/reconstructions")
    stop = page.get_by_role("button", name="Emergency stop")
    expect(page.locator("body")).to_have_attribute("data-live", "live")  # its scripts are there
    stop.click() if press == "click" else page.keyboard.press("Control+.")
    expect(page.locator("#stopped")).to_contain_text("laser off (confirmed by the device")
    assert laser(service) == "off"
    until(lambda: service.get(f"/scans/{scan}").json()["state"] == "aborted")
    page.get_by_role("button", name="Release …").click()
    page.get_by_label("Reason for the release").fill("the sample was moved")
    page.get_by_role("button", name="Release", exact=True).click()
    expect(page.locator("#stopped")).to_be_hidden()
    assert laser(service) is None


@pytest.fixture
def other(service):
    """A scanner of which another node of the service has charge, and nobody knows where that is."""
    database = Database(metadata_url(service.settings))
    scanner = ScannerRepository(database, scanner_id="scanner-1")
    scanner.ensure(simulated=True)
    # The service looks once in a while who there is: a press reaches whom it knows.
    until(lambda: len(service.http.post("/emergency-stop").json()["items"]) == 2)
    for name in ("scanner-0", scanner.id):
        service.http.delete(f"/scanners/{name}/emergency-stop").raise_for_status()
    yield scanner
    with database.write() as session:
        session.execute(delete(ScannerRow).where(ScannerRow.id == scanner.id))
    database.close()


def test_stop_button_stops_every_scanner_and_shows_worst_outcome(service, open_page, released, other):
    page = open_page(service, "/scans")
    expect(page.locator("#scanner")).to_contain_text("canner")
    page.get_by_role("button", name="Emergency stop").click()
    expect(page.locator("#stopped")).to_contain_text("no answer from scanner-1: use the hardware switch")
    assert laser(service) in AT_REST
    until(lambda: other.get(other.id).stopped_at)


def test_stop_without_scanner_list_stops_every_scanner(service, open_page, released, other):
    """As one that is opened while the database is away."""
    page = open_page(service, "/healthz")
    page.route("**/api/v1/scanners", lambda route: route.fulfill(status=503, json={"code": "database-unavailable"}))
    page.goto(f"{service.url}/data")
    page.get_by_role("button", name="Emergency stop").click()
    expect(page.locator("#stopped")).to_contain_text("use the hardware switch")
    until(lambda: other.get(other.id).stopped_at)
    assert laser(service) in AT_REST
    page.provoked("status of 503")  # what was refused


def test_a_scanner_that_does_not_let_its_stop_go_is_named_and_the_others_are_released(
    service, open_page, released, other
):
    page = open_page(service, "/scans")
    expect(page.locator("#scanner")).to_contain_text("2 scanners")
    page.get_by_role("button", name="Emergency stop").click()
    page.route(
        "**/scanners/scanner-1/emergency-stop*", lambda route: route.fulfill(status=503, json={"detail": "gone"})
    )
    page.get_by_role("button", name="Release …").click()
    page.get_by_label("Reason for the release").fill("it was a test")
    page.get_by_role("button", name="Release", exact=True).click()
    expect(page.get_by_role("dialog")).to_contain_text("scanner-1: gone")
    assert laser(service) is None
    page.keyboard.press("Escape")
    expect(page.locator("#stopped")).to_contain_text("no answer from scanner-1")
    service.http.delete("/scanners/scanner-1").raise_for_status()
    expect(page.locator("#stopped")).to_be_hidden()
    page.provoked("status of 503")  # what was refused


@pytest.mark.parametrize("known", [None, {"laser": "unconfirmed", "recorded": True}], ids=["nothing", "less"])
def test_stop_response_stays_shown_while_scanner_state_knows_less(service, open_page, known):
    """As on a node that has not the scanner: it knows from the database, and that learns it later."""
    stop = {"number": "01k0000000000000000000000", "at": "2026-01-01T00:00:00Z", "by": "Ada", "reason": "smoke"}
    answer = stop | {"laser": "off", "seconds": 0.1, "recorded": known is not None}
    scanner = scanner_of(service, emergency_stop=known and stop | {"seconds": None} | known)
    page = open_page(service, "/scans")
    told = {"items": [{"id": "scanner-0", "emergency_stop": answer, "links": {}}]}
    expect(page.get_by_role("button", name="Emergency stop")).to_be_enabled()
    page.route("**/emergency-stop", lambda route: route.fulfill(status=202, json=told))
    page.route("**/api/v1/scanners", lambda route: route.fulfill(json={"items": [scanner]}))
    page.get_by_role("button", name="Emergency stop").click()
    expect(page.locator("#stopped")).to_contain_text("laser off")
    for _ in range(2):  # when the second comes, the first has been shown
        with page.expect_response(re.compile("/api/v1/scanners$")):
            pass
    assert "laser off" in page.locator("#stopped").inner_text()
    scanner["emergency_stop"] = answer | {"by": "Ben", "recorded": True}
    expect(page.locator("#stopped")).to_contain_text("by Ben")
    scanner["emergency_stop"] = None
    expect(page.locator("#stopped")).to_be_hidden()


def test_the_stop_works_while_the_event_stream_is_cut(service, open_page, released):
    slow_scan(service)
    page = open_page(service, "/healthz")
    page.route("**/api/v1/events*", lambda route: route.abort())
    page.goto(f"{service.url}/data")
    expect(page.locator("#cut")).to_contain_text("Not live since")
    page.get_by_role("button", name="Emergency stop").click()
    expect(page.locator("#stopped")).to_contain_text("laser off (confirmed by the device")
    assert laser(service) == "off"
    page.provoked("net::ERR_FAILED")  # the stream that was cut


def test_failed_stop_request_shows_hardware_switch_hint(service, open_page, released):
    page = open_page(service, "/data")
    page.route("**/emergency-stop", lambda route: route.abort())
    page.get_by_role("button", name="Emergency stop").click()
    expect(page.locator("#stopped")).to_contain_text("no answer: use the hardware switch")
    assert laser(service) is None
    page.unroute("**/emergency-stop")
    expect(page.locator("#stopped")).to_contain_text(DONE)
    page.provoked("net::ERR_FAILED")  # the presses that were lost


def test_stop_request_without_response_is_sent_again(service, open_page, released):
    """As behind a proxy that holds a connection which leads nowhere."""
    page = open_page(service, "/data")
    held = []

    def hold_first(route):
        return route.continue_() if held or route.request.method == "GET" else held.append(route)

    page.route("**/api/v1/emergency-stop", hold_first)
    page.get_by_role("button", name="Emergency stop").click()
    expect(page.locator("#stopped")).to_contain_text("no answer: use the hardware switch")
    expect(page.locator("#stopped")).to_contain_text(DONE, timeout=60_000)
    assert laser(service) in AT_REST


def test_page_with_hanging_requests_reports_unresponsive_service(service, open_page):
    """Its event stream seems open: a connection that leads nowhere tells no end."""
    page = open_page(service, "/scans")
    expect(page.locator("body")).to_have_attribute("data-live", "live")
    expect(page.locator("#scanner")).to_contain_text("canner")
    page.route("**/api/v1/**", lambda route: None)
    expect(page.locator("#scanner")).to_contain_text("the service does not answer", timeout=60_000)
    expect(page.locator("#cut")).to_contain_text("Not live since")
    page.context.close()


def test_the_bar_follows_the_scan_that_it_names(service, open_page, released):
    scan = slow_scan(service)
    page = open_page(service, "/data")
    expect(page.locator("#running")).to_contain_text(" of ")
    shown = page.evaluate(
        "async () => { const { live } = await import('/static/event_stream.js');"
        " live._dispatch('progress', { kind: 'scan', id: 'another', done: 7, total: 9, eta: null });"
        " return document.getElementById('running').innerHTML; }"
    )
    assert scan in shown
    assert "7 of 9" not in shown
    service.http.post("/emergency-stop").raise_for_status()


def test_page_reconnects_after_event_stream_cut(service, open_page):
    page = open_page(service, "/scans")
    expect(page.locator("body")).to_have_attribute("data-live", "live")
    page.context.set_offline(True)
    page.evaluate("() => document.dispatchEvent(new Event('visibilitychange'))")
    expect(page.locator("#cut")).to_be_visible()
    page.context.set_offline(False)
    expect(page.locator("body")).to_have_attribute("data-live", "live")
    expect(page.locator("#cut")).to_be_hidden()
    page.provoked("net::ERR_INTERNET_DISCONNECTED")


def test_late_event_listener_receives_refresh_event(service, open_page):
    """A view's script may come later than the stream: a scan's page then waited for ever."""
    page = open_page(service, "/scans")
    expect(page.locator("body")).to_have_attribute("data-live", "live")
    assert (
        page.evaluate(
            "async () => { const { live } = await import('/static/event_stream.js');"
            " return await new Promise((go) => {"
            " live.on('again', () => go('told')); setTimeout(() => go('not told'), 3000); }); }"
        )
        == "told"
    )


def test_keys_lead_from_view_to_view(service, open_page):
    page = open_page(service, "/data")
    expect(page.get_by_role("button", name="Sign out")).to_be_hidden()  # without keys nobody signs in
    page.keyboard.press("?")
    expect(page.get_by_role("dialog")).to_contain_text("Emergency stop")
    page.keyboard.press("Escape")
    page.keyboard.press("g")
    page.keyboard.press("s")
    page.wait_for_url("**/scans")
    page.keyboard.press("/")
    expect(page.get_by_role("searchbox")).to_be_focused()


def test_theme_follows_system_until_user_selects_one(service, open_page):
    page = open_page(service, "/data", color_scheme="light")
    background = "() => getComputedStyle(document.body).backgroundColor"
    light = page.evaluate(background)
    page.emulate_media(color_scheme="dark")
    dark = page.evaluate(background)
    assert brightness(light) > 200
    assert brightness(dark) < 50
    page.get_by_role("button", name="Change to the light theme").click()
    page.reload()
    assert page.evaluate(background) == light


def brightness(colour):
    return sum(map(int, re.findall(r"\d+", colour)[:3])) / 3


def test_a_lab_adds_a_panel_by_a_script_of_its_own(chromium, open_page, tmp_path):
    lab = tmp_path / "lab"
    lab.mkdir()
    example = re.search("```js\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    (lab / "water.js").write_text(example[1])
    (lab / "bath.json").write_text('{"celsius": 21.5}')
    (lab / "panel.js").write_text(
        "document.addEventListener('steradian:ready', async ({ detail: { page, api, live, panels } }) => {\n"
        "  const { version } = await api.get('');\n"
        "  panels.main.append(`a panel on ${page}, service ${version}, ${typeof live.on}`);\n});\n"
    )
    service = Service(tmp_path / "data", log=tmp_path / "log", page_scripts=lab).start()
    try:
        page = open_page(service, "/data")
        expect(page.locator("main")).to_contain_text("a panel on data, service 0.1.0, function")
        expect(page.locator(".tools")).to_contain_text("water 21.5 °C")
        page.context.close()
    finally:
        service.close()


def test_a_key_is_asked_for_once_and_a_cookie_does_the_rest(open_page, tmp_path):
    key = "sk_test_a_key_that_nobody_guesses"
    service = Service(tmp_path / "data", log=tmp_path / "log", require_key=True, api_key=key).start()
    try:
        page = open_page(service, "/scans")
        page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
        for _ in range(2):  # the page goes on looking, and asks nobody
            with page.expect_response(re.compile("/api/v1/scanners$")):
                pass
        expect(page.get_by_role("dialog")).to_have_count(0)
        page.get_by_role("button", name="Sign in").click()
        page.get_by_label("API key").fill("wrong")
        page.get_by_role("button", name="Sign in").click()
        expect(page.get_by_role("dialog").get_by_role("alert")).not_to_be_empty()
        page.get_by_label("API key").fill(key)
        page.get_by_role("button", name="Sign in").click()
        expect(page.get_by_text("No scans yet")).to_be_visible()
        page.goto(f"{service.url}/scans")
        expect(page.locator("body")).to_have_attribute("data-live", "live")
        page.get_by_role("button", name="Emergency stop").click()
        expect(page.locator("#stopped")).to_contain_text(DONE)
        asked = {"Authorization": f"Bearer {key}"}
        assert httpx.get(f"{service.url}/api/v1/scanners/scanner-0", headers=asked).json()["emergency_stop"] is not None
        assert "steradian_session" not in page.evaluate("document.cookie")
        cookies = {one["name"]: one["value"] for one in page.context.cookies()}
        session = f"{service.url}/api/v1/session"
        assert httpx.get(session, cookies=cookies).json()["csrf_token"]
        assert httpx.delete(session, cookies=cookies).status_code == 403, "no other page signs anybody out"
        page.get_by_role("button", name="Sign out").click()
        expect(page.get_by_role("dialog").get_by_label("API key")).to_be_visible()
        assert httpx.get(session, cookies=cookies).status_code == 401
        expect(page.get_by_role("button", name="Sign out")).to_be_hidden()
        page.context.close()
        page.provoked("status of 401")  # a key is needed
    finally:
        service.close()
