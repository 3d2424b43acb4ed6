"""A scan that begins with the A-lines of an earlier one: which may, and what it is told otherwise."""

import uuid

import pytest


def ask(http, plan_id, completes):
    body, key = {"plan_id": plan_id, "completes": completes}, {"Idempotency-Key": uuid.uuid4().hex}
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
def test_what_cannot_be_completed_is_refused(http, wishes, which):
    plan, scan, status, code = wishes[which]
    answer = ask(http, plan, scan)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
