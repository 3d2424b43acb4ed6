"""What can be wished of a scan through the API, and what is answered when it cannot."""

import pytest

from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState

S = ScanState


def lead(server, scan, *states):
    scans = ScanRepository(server.database)
    for state in states:
        scans.transition(scan["id"], state, why="test")


def put(http, scan, state):
    return http.put(f"/scans/{scan['id']}/desired-state", json={"state": state, "reason": "because"})


@pytest.mark.parametrize("times", [1, 2])
def test_running_scan_pause_and_resume_are_idempotent(server, http, scan, times):
    lead(server, scan, S.ARMING, S.RUNNING)
    for state in ("paused", "running", "paused"):
        for _ in range(times):
            answer = put(http, scan, state)
            assert (answer.status_code, answer.json()["desired_state"]) == (200, state)
    assert put(http, scan, "stopped").json()["desired_state"] == "stopped"


@pytest.mark.parametrize(("end", "refused"), [("stopped", ["running", "paused"]), ("aborted", ["running", "stopped"])])
def test_an_end_cannot_be_taken_back(server, http, scan, end, refused):
    lead(server, scan, S.ARMING, S.RUNNING)
    assert put(http, scan, end).status_code == 200
    for state in refused:
        answer = put(http, scan, state)
        assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
    assert http.get(f"/scans/{scan['id']}").json()["desired_state"] == end


def test_interrupted_scan_defaults_to_paused_and_accepts_running(server, http, scan):
    lead(server, scan, S.ARMING, S.RUNNING, S.INTERRUPTED)
    shown = http.get(f"/scans/{scan['id']}").json()
    assert (shown["state"], shown["desired_state"]) == ("interrupted", "paused"), "nobody wants it to fire by itself"
    answer = put(http, scan, "running")
    assert (answer.status_code, answer.json()["desired_state"]) == (200, "running")
    assert answer.json()["reason"] == "because"


def test_a_queued_scan_cannot_be_paused(http, scan):
    answer = put(http, scan, "paused")
    assert answer.status_code == 409
    assert "allowed: aborted, stopped" in answer.json()["detail"]


def test_desired_state_of_finished_scan_returns_409(server, http, scan):
    lead(server, scan, S.ARMING, S.RUNNING, S.COMPLETING, S.COMPLETE)
    for state in ("paused", "stopped", "aborted"):
        assert put(http, scan, state).status_code == 409


def test_full_disk_condition_appears_in_scan_progress(server, http, scan):
    lead(server, scan, S.ARMING, S.RUNNING)
    ScanRepository(server.database).report_condition(scan["id"], "blocked: the disk is full", "the disk is full")
    assert http.get(f"/scans/{scan['id']}").json()["progress"]["stage"] == "blocked: the disk is full"


def test_shots_and_coverage_say_which_frame(http, scan_with_alines):
    scan = scan_with_alines["scan"]
    shots = http.get(f"/scans/{scan['id']}/shots").json()
    assert shots["points"] == list(range(53))
    assert shots["frames"] == [0] * 53
    assert http.get(f"/scans/{scan['id']}/coverage").json()["frames"] == 1
