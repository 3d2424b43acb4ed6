from dataclasses import replace

import numpy as np
import pytest

from steradian.errors import Conflict, InvalidInput, NotFound
from steradian.storage.idempotency import Answer, Answers, Key
from steradian.storage.masks import MaskRepository
from steradian.storage.plans import PlanRepository
from steradian.storage.reconstructions import ReconstructionRepository
from steradian.storage.scans import ScanRepository
from steradian.storage.states import DesiredScanState, ScanState

S = ScanState


@pytest.fixture
def scans(database, clock):
    return ScanRepository(database, clock)


@pytest.fixture
def scan(scans, plan_row):
    return scans.queue(plan_row, simulated=True)


def lead(scans, scan, *states):
    for state in states:
        scans.transition(scan.id, state, why="test")


def test_a_mask_and_a_plan_come_back_as_they_went_in(database, clock, plan):
    masks, plans = MaskRepository(database, clock), PlanRepository(database, clock)
    assert masks.put(plan.mask)[1] is True
    assert masks.put(plan.mask)[1] is False
    assert plans.put(plan)[1] is True
    assert plans.put(plan)[1] is False
    kept = plans.load(plan.id)
    assert (kept.id, kept.mask.id) == (plan.id, plan.mask.id)
    np.testing.assert_array_equal(kept.mask.positions, plan.mask.positions)
    np.testing.assert_array_equal(kept.mask.weights, plan.mask.weights)


def test_an_unknown_identifier_is_named(database):
    for repository in (MaskRepository, PlanRepository, ScanRepository, ReconstructionRepository):
        with pytest.raises(NotFound, match=f"no {repository.kind} 'nope'"):
            repository(database).get("nope")


def test_a_scan_keeps_its_history_and_times(scans, scan, clock):
    clock.advance(seconds=5)
    lead(scans, scan, S.ARMING, S.RUNNING)
    scans.report(scan.id, "A-lines", 3, 10)
    clock.advance(seconds=5)
    lead(scans, scan, S.COMPLETING, S.COMPLETE)
    row = scans.get(scan.id)
    assert [entry["state"] for entry in row.history] == ["queued", "arming", "running", "completing", "complete"]
    assert (row.ended - row.started).total_seconds() == 5
    assert (row.stage, row.done, row.total) == ("A-lines", 3, 10)


def test_a_refused_transition_changes_nothing(scans, scan):
    with pytest.raises(Conflict, match="allowed: aborted, arming"):
        scans.transition(scan.id, S.COMPLETE, why="test")
    assert scans.get(scan.id).state is S.QUEUED
    assert len(scans.get(scan.id).history) == 1


def test_after_a_restart_only_what_was_under_way_is_interrupted(scans, plan_row):
    queued, running, complete = (scans.queue(plan_row, simulated=True) for _ in range(3))
    lead(scans, running, S.ARMING, S.RUNNING)
    lead(scans, complete, S.ARMING, S.RUNNING, S.COMPLETING, S.COMPLETE)
    assert scans.interrupt_all("restart") == [running.id]
    assert scans.get(running.id).state is S.INTERRUPTED
    assert scans.get(queued.id).state is S.QUEUED
    assert scans.get(complete.id).state is S.COMPLETE
    assert scans.next_queued().id == queued.id


def test_the_oldest_scan_is_next(scans, plan_row):
    first, _ = (scans.queue(plan_row, simulated=True) for _ in range(2))
    assert scans.next_queued().id == first.id


def test_a_wish_can_be_repeated_but_not_made_of_a_finished_scan(scans, scan):
    scans.desire(scan.id, DesiredScanState.STOPPED, "enough")
    scans.desire(scan.id, DesiredScanState.STOPPED, "again")
    assert scans.get(scan.id).reason == "enough"
    lead(scans, scan, S.ARMING, S.FAILED)
    with pytest.raises(Conflict, match="it is over"):
        scans.desire(scan.id, DesiredScanState.ABORTED, None)


def test_a_repeated_key_gets_the_same_answer_for_a_day(database, clock):
    made = []

    def make(_session):
        made.append(len(made))
        return Answer(201, f"/{made[-1]}", "{}")

    answers, key = Answers(database, clock), Key("ada", "/scans", "k", "b")
    first = answers.once(key, make)
    assert (first.location, first.replayed) == ("/0", False)
    again = answers.once(key, make)
    assert (again.location, again.replayed) == ("/0", True)
    with pytest.raises(InvalidInput, match="Idempotency-Key"):
        answers.once(replace(key, body_hash="other"), make)
    assert answers.once(replace(key, principal="bob"), make).location == "/1"
    clock.advance(hours=25)
    assert answers.once(key, make).location == "/2"
    assert answers.once(None, make).location == "/3"


def test_pages_show_every_row_once_newest_first(scans, plan_row):
    made = [scans.queue(plan_row, simulated=True).id for _ in range(5)]
    seen, before = [], None
    while True:
        page = scans.page(2, before)
        seen += [row.id for row in page.rows]
        if (before := page.cursor) is None:
            break
    assert seen == made[::-1]
