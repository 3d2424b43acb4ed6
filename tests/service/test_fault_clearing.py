"""A fault that the interlock latched: a person clears it once its cause is gone; the scan then goes on exactly once."""

import json
import sqlite3

import pytest

from fabry_perot.simulator import launch
from steradian.scans.acquisition.resume_checks import REFERENCE_SHOTS
from support.services import Service
from support.waiting import until

SCANNER = "/scanners/scanner-0"
CLEAR = f"{SCANNER}/clear-fault"
pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def scanner():
    with launch(speed=10.0) as simulator:
        yield simulator


@pytest.fixture(scope="module")
def service(scanner, tmp_path_factory):
    service = Service(tmp_path_factory.mktemp("service"), scanner=scanner.url, workers=0).start()
    yield service
    service.close()


def seen(service, **expected):
    """The scanner as the service shows it, once it shows what is expected."""
    return until(
        lambda: (
            (now := service.get(SCANNER).json()) and all(now[name] == value for name, value in expected.items()) and now
        ),
        tell=lambda: service.get(SCANNER).json(),
    )


def wish(service, scan, state):
    return service.http.put(f"/scans/{scan}/desired-state", json={"state": state})


def at(service, scan, *states):
    return until(
        lambda: (now := service.get(f"/scans/{scan}").json())["state"] in states and now,
        tell=lambda: service.get(f"/scans/{scan}").json(),
    )


def deeds(service):
    """What the log of events says about the scanner, as pairs of who and why, oldest first."""
    with sqlite3.connect(service.folder / "steradian.sqlite") as database:
        rows = database.execute("SELECT data FROM events WHERE kind = 'scanner' ORDER BY sequence").fetchall()
    database.close()
    return [(one["who"], one["why"]) for one in (json.loads(row) for (row,) in rows)]


def test_clear_fault_without_a_fault_changes_nothing(service):
    seen(service, connection="connected", laser="off")
    for _ in range(2):
        answer = service.http.post(CLEAR)
        assert answer.status_code == 200, answer.text
        assert answer.json()["fault"] is None


@pytest.mark.long
def test_a_scan_after_an_opened_interlock_goes_on_exactly_once_when_the_fault_is_cleared(service, scanner):
    scan = service.start_scan(service.plan(300, pulse_rate=20))["id"]
    until(lambda: service.get(f"/scans/{scan}").json()["progress"]["done"] > 20)
    scanner.send_command("interlock", closed=False)
    lost = at(service, scan, "interrupted")
    assert lost["error"]["code"] == "fault-latched"
    assert "interlock-opened" in lost["error"]["detail"]
    assert "clear-fault" in lost["error"]["detail"]
    assert "fault 1" not in str(lost)
    shown = seen(service, state="fault", interlock="open", laser="off", shutter="closed")
    assert (shown["fault"]["name"], shown["fault"]["clearable"]) == ("interlock-opened", False)
    assert shown["last_error"].startswith("the interlock was opened")

    refused = service.http.post(CLEAR, json={"reason": "closed again"})
    assert (refused.status_code, refused.json()["code"]) == (409, "fault-stands"), refused.text
    assert "the interlock is open" in refused.json()["detail"]

    scanner.send_command("interlock", closed=True)
    assert seen(service, interlock="closed")["fault"]["clearable"]
    assert wish(service, scan, "running").is_success
    history = lambda: [one["state"] for one in service.get(f"/scans/{scan}").json()["history"]]  # noqa: E731
    until(lambda: history().count("interrupted") == 2)
    again = at(service, scan, "interrupted")
    assert "interlock-opened" in again["error"]["detail"]

    seen(service, interlock="closed", connection="connected")
    cleared = service.http.post(CLEAR, json={"reason": "closed again"})
    assert cleared.status_code == 200, cleared.text
    seen(service, fault=None, last_error=None, state="idle")
    assert wish(service, scan, "running").is_success
    until(lambda: history().count("arming") == 3)
    whole = at(service, scan, "complete", "partial", "aborted", "failed", "interrupted")
    assert whole["state"] == "complete", whole["error"]
    points, fired = whole["summary"]["points"], whole["summary"]["fired"]
    assert whole["summary"]["stored"] == points
    assert fired == scanner.send_command("report")["shots"], "no shot more than the scan knows of"
    assert fired - points <= 2 * REFERENCE_SHOTS, (
        "each point once, but for the proof and the average that was broken off"
    )
    assert ("local", "fault cleared: interlock-opened: closed again") in deeds(service)
