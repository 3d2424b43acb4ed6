"""A scan that begins with the A-lines of an earlier one: which may, and what it is told otherwise."""

import uuid
from contextlib import suppress

import pytest
from sqlalchemy import update

from steradian.core.exceptions import NotFound
from steradian.storage.db.tables import ScanRow
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState


def ask(http, plan_id, completes, **more):
    body, key = {"plan_id": plan_id, "completes": completes} | more, {"Idempotency-Key": uuid.uuid4().hex}
    return http.post("/scans", json=body, headers=key)


def test_a_scan_that_ended_early_is_completed_by_another_one(http, scan_with_alines):
    scan = scan_with_alines["scan"]
    made = ask(http, scan["plan_id"], scan["id"])
    assert (made.status_code, made.json()["completes"], made.json()["state"]) == (201, scan["id"], "queued")
    assert http.get(f"/scans/{scan['id']}").json()["completes"] is None


@pytest.fixture
def wishes(http, scan, scan_with_alines):
    """Which scan with which plan."""
    whole = scan_with_alines["scan"]
    other = http.post("/plans", json={"mask_id": whole["mask_id"], "samples": 300}).json()
    return {
        "of another plan": (other["id"], whole["id"], 422, "invalid-input"),
        "not over": (scan["plan_id"], scan["id"], 409, "conflict"),
        "not there": (scan["plan_id"], "s00000000000000000000000000", 404, "not-found"),
    }


@pytest.mark.parametrize("which", ["of another plan", "not over", "not there"])
def test_complete_scan_with_unsuitable_scan_is_rejected(http, wishes, which):
    plan, scan, status, code = wishes[which]
    answer = ask(http, plan, scan)
    assert (answer.status_code, answer.json()["code"]) == (status, code)


@pytest.fixture
def scanners(server):
    """Makes scanners of other nodes, which are there until the test ends."""
    made = []

    def make(name):
        made.append(ScannerRepository(server.database, scanner_id=name))
        made[-1].ensure(simulated=True)
        return made[-1]

    yield make
    for each in made:
        for scan in ScanRepository(server.database, scanner_id=each.id).unfinished():
            ScanRepository(server.database).transition(scan.id, ScanState.ABORTED, why="test")
        with suppress(NotFound):
            each.retire("test")


def measured_by(server, scan, name):
    with server.database.write() as session:
        session.execute(update(ScanRow).where(ScanRow.id == scan["id"]).values(scanner_id=name))


def test_a_scan_is_completed_by_the_scanner_that_measured_it(server, http, scan_with_alines, scanners):
    """Another one could prove nothing of what it was; the laser would be armed in vain."""
    scan = scan_with_alines["scan"]
    scanners("scanner-1")
    measured_by(server, scan, "scanner-1")
    refused = ask(http, scan["plan_id"], scan["id"], scanner_id="scanner-0")
    assert (refused.status_code, refused.json()["errors"][0]["pointer"]) == (422, "#/scanner_id")
    assert "scanner-1" in refused.json()["errors"][0]["allowed"]
    made = ask(http, scan["plan_id"], scan["id"])
    assert (made.status_code, made.json()["scanner_id"]) == (201, "scanner-1"), "need not be said"


def test_complete_scan_of_retired_scanner_runs_on_named_scanner(server, http, scan_with_alines, scanners):
    """It may be the same one under another name: that is proved when it begins."""
    scan, gone = scan_with_alines["scan"], scanners("scanner-1")
    measured_by(server, scan, "scanner-1")
    gone.retire("Ada")
    made = ask(http, scan["plan_id"], scan["id"], scanner_id="scanner-0")
    assert (made.status_code, made.json()["scanner_id"]) == (201, "scanner-0")
