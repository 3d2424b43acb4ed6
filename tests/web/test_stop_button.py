"""The stop button: it is there while a press would be taken, and else a sentence why not."""

import json
import uuid
from datetime import UTC, datetime, timedelta

import pytest
from playwright.sync_api import expect

from steradian.security.keys import KeyStore, Scope
from steradian.storage.db.database import Database, metadata_url
from support.services import Service
from support.waiting import until

FIXED = "sk_test_a_key_that_nobody_guesses"
STOP = "/scanners/scanner-0/emergency-stop"
WORKS = "The emergency stop works."
SILENT = "The service does not answer: the emergency stop may not reach the laser"


class Keyed(Service):
    """A service that needs a key, and what makes and revokes others."""

    def __init__(self, folder):
        super().__init__(folder, log=folder.parent / f"{folder.name}.log", require_key=True, api_key=FIXED)
        self.start()
        self.http.headers["Authorization"] = f"Bearer {FIXED}"
        self.database = Database(metadata_url(self.settings))
        self.keys = KeyStore(self.database)

    def close(self):
        self.database.close()
        super().close()


@pytest.fixture(scope="module")
def keyed(tmp_path_factory):
    keyed = Keyed(tmp_path_factory.mktemp("keyed"))
    yield keyed
    keyed.close()


@pytest.fixture
def signed_in(keyed, open_page):
    """A page that is signed in, and the identifier of its key."""
    key = keyed.keys.create("bench", [Scope.READ, Scope.OPERATE])
    page = open_page(keyed, "/data")
    sign_in(page, key)
    page.provoked("status of 401")  # before that, and after the key is revoked
    yield page, key.split("_")[1]
    keyed.http.delete(STOP)


def sign_in(page, key):
    page.get_by_label("API key").fill(key)
    page.get_by_role("dialog").get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(button(page)).to_be_enabled()


def button(page):
    return page.get_by_role("button", name="Emergency stop")


def presses_of(page):
    """Requests that press the stop, as the page sends them."""
    found = []
    page.on("request", lambda one: found.append(one) if one.method == "POST" and "emergency-stop" in one.url else None)
    return found


def test_stop_with_revoked_key_turns_laser_off(keyed, signed_in):
    page, identifier = signed_in
    plan = keyed.plan(pulse_rate=1, averages=24)
    scan = keyed.http.post("/scans", json={"plan_id": plan}, headers={"Idempotency-Key": uuid.uuid4().hex}).json()
    until(lambda: keyed.get(f"/scans/{scan['id']}").json()["progress"]["done"] >= 1)
    keyed.keys.revoke(identifier)
    expect(page.locator("#cut")).to_contain_text("Signed out")
    expect(page.locator("#cut")).to_contain_text(WORKS)
    expect(page.locator("#scanner")).to_contain_text("laser: unknown")
    by_ticket = f"key bench ({identifier}) (stop ticket)"  # keys are remembered for a second, for the stop
    with page.expect_response(lambda one: one.request.method == "GET" and by_ticket in one.text()):
        pass
    button(page).click()
    expect(page.locator("#stopped")).to_contain_text("laser off (confirmed by the device")
    stop = keyed.get("/scanners/scanner-0").json()["emergency_stop"]
    assert stop["laser"] == "off"
    assert stop["by"] == by_ticket
    until(lambda: keyed.get(f"/scans/{scan['id']}").json()["state"] == "aborted")


def test_page_without_session_has_no_stop_button_and_shows_reason(keyed, open_page):
    page = open_page(keyed, "/data")
    expect(page.locator("#no-stop")).to_have_text(
        "Not signed in: this page cannot stop the laser. Sign in, or use the hardware switch."
    )
    expect(page.locator("#stop")).to_be_hidden()
    expect(page.locator("#stop")).to_be_disabled()
    assert "works" not in page.locator(".under-bar").inner_text()
    presses = presses_of(page)
    page.keyboard.press("Control+.")  # it is tried, and refused
    expect(page.locator("#stopped")).to_contain_text("not accepted: use the hardware switch")
    expect(page.locator("#stopped")).to_contain_text("The page does not repeat the stop.")
    for _ in range(2):
        with page.expect_response("**/api/v1/emergency-stop"):  # it asks whether it could
            pass
    assert len(presses) == 1
    sign_in(page, FIXED)
    expect(page.locator("#no-stop")).to_be_hidden()
    expect(page.locator("#stopped")).to_be_hidden()
    page.provoked("status of 401")


def test_sign_out_in_one_page_takes_the_stop_button_from_the_others(keyed, signed_in):
    page, _ = signed_in
    other = page.context.new_page()
    other.goto(f"{keyed.url}/scans")
    expect(button(other)).to_be_enabled()
    other.get_by_role("button", name="Sign out").click()
    expect(page.locator("#no-stop")).to_have_text(
        "Signed out: this page cannot stop the laser. Sign in, or use the hardware switch."
    )
    expect(page.locator("#stop")).to_be_hidden()


def test_page_refused_by_service_has_no_stop_button(service, open_page):
    page = open_page(service, "/data")
    expect(button(page)).to_be_enabled()
    refusal = {"code": "forbidden", "detail": "this service is not addressed so"}
    page.route("**/api/v1/emergency-stop", lambda route: route.fulfill(status=403, json=refusal))
    expect(page.locator("#no-stop")).to_contain_text("Refused (this service is not addressed so)")
    expect(page.locator("#stop")).to_be_hidden()
    page.unroute("**/api/v1/emergency-stop")
    expect(button(page)).to_be_enabled()
    page.provoked("status of 403")


def test_stop_of_ended_service_is_never_called_working(open_page, tmp_path):
    service = Service(tmp_path / "data", log=tmp_path / "log").start()
    try:
        page = open_page(service, "/data")
        expect(button(page)).to_be_enabled()
        page.provoked("net::ERR")
        page.evaluate(
            "() => { window.said = new Set(); const line = document.getElementById('cut');"
            " new MutationObserver(() => window.said.add(line.textContent)).observe(line, { childList: true,"
            " characterData: true, subtree: true }); }"
        )
        service.process.kill()
        service.process.wait()
        expect(page.locator("#cut")).to_contain_text(SILENT)
        button(page).click()  # it is sent all the same: the service may come back
        expect(page.locator("#stopped")).to_contain_text("the page repeats the stop")
        assert not [text for text in page.evaluate("() => [...window.said]") if "works" in text]
        assert "works" not in page.locator("body").inner_text()
        page.context.close()
    finally:
        service.close()


def test_stop_without_event_stream_is_called_working_only_after_check(service, open_page):
    page = open_page(service, "/healthz")
    page.route("**/api/v1/events*", lambda route: route.abort())
    page.goto(f"{service.url}/data")
    expect(page.locator("#cut")).to_contain_text(f"reconnecting. {WORKS}")
    page.route("**/api/v1/emergency-stop", lambda route: None)
    expect(page.locator("#cut")).to_contain_text(SILENT)
    expect(page.locator("#cut")).not_to_contain_text("works")
    page.provoked("net::ERR_FAILED")
    page.context.close()


@pytest.mark.parametrize("missing", ["shell", "emergency_stop", "scanner_status"])
def test_page_with_missing_script_has_no_enabled_stop_button(service, open_page, missing):
    page = open_page(service, "/healthz")
    page.route(f"**/static/{missing}.js", lambda route: route.fulfill(status=404, body=""))
    page.goto(f"{service.url}/data")
    page.wait_for_load_state("networkidle")
    expect(page.locator("#stop")).to_be_disabled()
    expect(page.locator("#stop")).to_be_hidden()
    expect(page.locator("#no-stop")).to_have_text(
        "The emergency stop of this page is not ready: use the hardware switch."
    )
    page.provoked("status of 404")


def test_expiring_session_is_announced_and_can_be_renewed(keyed, signed_in):
    page, _ = signed_in
    soon = (datetime.now(UTC) + timedelta(minutes=12)).isoformat()

    def answer(route):
        if route.request.method != "GET":
            return route.continue_()
        told = route.fetch()
        return route.fulfill(response=told, body=json.dumps(told.json() | {"expires": soon}))

    page.route("**/api/v1/session", answer)
    page.reload()
    expect(page.locator("#session")).to_contain_text("Your session ends at")
    page.get_by_role("button", name="Stay signed in …").click()
    page.get_by_label("API key").fill(FIXED)
    page.get_by_role("dialog").get_by_role("button", name="Sign in").click()
    expect(page.locator("#session")).to_be_hidden()
