"""The scanner in the bar: what it says of the laser while an emergency stop stands."""

import pytest
from playwright.sync_api import expect


@pytest.mark.parametrize(
    ("laser", "state", "told"),
    [
        ("unconfirmed", "idle", "stop not confirmed"),
        ("unconfirmed", "scanning", "laser on"),
        ("off", "scanning", "stopped, laser off"),
        ("idle", "idle", "stopped"),
        (None, "idle", "idle, laser off"),
    ],
)
def test_the_pill_says_laser_off_only_where_that_is_known(service, open_page, laser, state, told):
    """A stop that nobody confirmed leaves open whether it fires, whatever else is known of the scanner."""
    stop = {"number": "01k0", "at": "2026-01-01T00:00:00Z", "by": "Ada", "reason": None, "seconds": None}
    scanner = service.get("/scanners/scanner-0").json() | {"connection": "connected", "state": state}
    scanner["emergency_stop"] = laser and stop | {"laser": laser, "recorded": True}
    page = open_page(service, "/healthz")
    page.route("**/api/v1/scanners", lambda route: route.fulfill(json={"items": [scanner]}))
    page.goto(f"{service.url}/data")
    pill = page.locator("#scanner")
    expect(pill).to_contain_text(f"connected{told}")
    assert ("laser off" in pill.inner_text()) == (laser in {"off", None})
    if laser is None:  # nor does a press that is on its way know more
        page.route("**/emergency-stop", lambda route: route.abort())
        page.get_by_role("button", name="Emergency stop").click()
        expect(pill).to_contain_text("stop sent")
        expect(pill).not_to_contain_text("laser off")
        page.provoked("net::ERR_FAILED")  # the presses that were lost
