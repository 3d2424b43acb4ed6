"""The scanner in the bar: its laser is called off only where the device has just said so."""

import re

import pytest
from playwright.sync_api import expect

from support.scanners import scanner_of, tell_of

STOP = {"number": "01k0", "at": "2026-01-01T00:00:00Z", "by": "Ada", "reason": None, "seconds": None, "recorded": True}
HOLDER = "steradian (process 4242)"
AT_REST = re.compile(r"\b(off|idle)\b")


@pytest.fixture
def shown(service, open_page):
    """Open a page of a service that tells of these scanners; returns its header and pill."""

    def shown(*scanners):
        page = open_page(service, "/healthz")
        tell_of(page, *scanners)
        page.goto(f"{service.url}/data")
        expect(page.get_by_role("button", name="Emergency stop")).to_be_enabled()
        return page, page.locator("#scanner")

    return shown


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({}, "connected|laser off|shutter closed|interlock closed|updated"),
        ({"laser": "on", "shutter": "open", "state": "scanning"}, "laser on|shutter open|interlock closed"),
        ({"laser": "armed", "state": "scanning"}, "laser armed|shutter closed"),
        ({"state": "idle", "laser": "unknown"}, "connected|laser: unknown (not reported by the scanner)"),
        ({"laser": "off", "age": None}, "laser: unknown"),
        ({"laser": "off", "age": 3.5}, "laser: unknown (the status is out of date)"),
        ({"connection": "disconnected", "laser": "unknown", "age": None, "last_error": "it is gone"}, "(it is gone)"),
        ({"connection": "in-use", "holder": HOLDER, "laser": "on"}, f"in use by {HOLDER}|laser on"),
        ({"connection": "in-use", "holder": HOLDER, "laser": "unknown", "age": None}, f"in use by {HOLDER}|laser: unk"),
        ({"connection": "unknown", "laser": "unknown", "age": None}, "not started|laser: unknown"),
        ({"simulated": False, "connection": "unknown", "laser": "unknown"}, "connection unknown|laser: unknown"),
        ({"interlock": "open", "laser": "off"}, "laser off|shutter closed|interlock open"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_status_pill_of_one_scanner_shows_device_state(service, shown, fields, told):
    page, pill = shown(scanner_of(service, **fields))
    expect(pill).to_contain_text(re.compile(".*".join(map(re.escape, told.split("|")))))
    assert bool(AT_REST.search(page.locator("header").inner_text())) is ("laser off" in told)


@pytest.mark.parametrize(
    ("stop", "fields", "told", "panel"),
    [
        ("unconfirmed", {"laser": "unknown", "age": None}, "stop not confirmed|laser: unknown", "use the hardware"),
        ("unconfirmed", {"laser": "on"}, "stop not confirmed|laser on", "use the hardware switch"),
        ("off", {"laser": "off"}, "stopped|laser off", "laser off (confirmed by the device"),
        ("off", {"laser": "on"}, "stopped|laser on", "but the laser is on again: use the hardware switch"),
        ("off", {"laser": "unknown", "age": None}, "stopped|laser: unknown", "the laser state is now unknown"),
        (
            "idle",
            {"laser": "unknown", "age": None},
            "stopped|laser: unknown",
            "no scanner is connected to this service",
        ),
    ],
)
def test_pill_and_panel_of_a_stopped_scanner_say_how_the_laser_is_now(service, shown, stop, fields, told, panel):
    page, pill = shown(scanner_of(service, emergency_stop=STOP | {"laser": stop}, **fields))
    expect(pill).to_contain_text(re.compile(".*".join(map(re.escape, told.split("|")))))
    expect(page.locator("#stopped")).to_contain_text(panel)
    text = page.locator("header").inner_text() + page.locator("#stopped").inner_text()
    assert bool(AT_REST.search(text)) is (fields["laser"] == "off")


def test_stop_panel_of_unconfirmed_stop_shows_reason(service, shown):
    why = f"in use by {HOLDER}, which does not answer: use the hardware switch"
    page, _ = shown(scanner_of(service, emergency_stop=STOP | {"laser": "unconfirmed", "detail": why}, laser="unknown"))
    expect(page.locator("#stopped")).to_contain_text(f"In use by {HOLDER}")


def test_pill_during_a_press_that_is_not_answered_does_not_say_off(service, shown):
    page, pill = shown(scanner_of(service))
    expect(pill).to_contain_text("laser off")
    page.route("**/emergency-stop", lambda route: route.abort())
    page.get_by_role("button", name="Emergency stop").click()
    expect(pill).to_contain_text("stop sent")
    expect(pill).not_to_contain_text("off")
    page.provoked("net::ERR_FAILED")  # the presses that were lost


def test_status_pill_of_several_scanners_shows_off_only_if_all_are_off(service, shown):
    one, other = scanner_of(service), scanner_of(service) | {"id": "scanner-1", "laser": "unknown", "age": None}
    page, pill = shown(one, other)
    expect(pill).to_contain_text("2 scanners")
    expect(pill).to_contain_text("laser unknown: scanner-1")
    assert not AT_REST.search(page.locator("header").inner_text())
    tell_of(page, one, other | {"laser": "off", "age": 0.2})
    expect(pill).to_contain_text("laser off")
    tell_of(page, one, other | {"laser": "on", "age": 0.2})
    expect(pill).to_contain_text("laser on: scanner-1")
    expect(pill).not_to_contain_text("off")


def test_pill_while_answers_hang_becomes_unknown(service, shown):
    page, pill = shown(scanner_of(service))
    expect(pill).to_contain_text("laser off")
    page.route("**/api/v1/**", lambda route: None)  # none is answered
    expect(pill).to_contain_text("laser: unknown")
    assert not AT_REST.search(page.locator("header").inner_text())
    expect(page.locator("#cut")).to_contain_text(
        "The service does not answer: the emergency stop may not reach the laser"
    )
    page.context.close()


def test_pill_of_a_page_that_was_hidden_is_unknown_until_it_is_looked_at_again(service, shown):
    page, pill = shown(scanner_of(service))
    expect(pill).to_contain_text("laser off")
    hide = "(is) => { Object.defineProperty(document, 'hidden', { configurable: true, get: () => is });"
    hide += (
        " document.dispatchEvent(new Event('visibilitychange')); return document.querySelector('header').innerText; }"
    )
    assert not AT_REST.search(page.evaluate(hide, True))
    assert not AT_REST.search(page.evaluate(hide, False)), "not before the next answer"
    expect(pill).to_contain_text("laser off")


def test_status_pill_states_polling_interval(service, shown):
    _, pill = shown(scanner_of(service))
    expect(pill).to_have_attribute("title", re.compile("every 200.ms. This page polls the service every second"))
