from dataclasses import replace

import numpy as np
import pytest

from steradian.core.exceptions import Conflict, InvalidInput, NotFound
from steradian.storage.repositories.batches import BatchRepository
from steradian.storage.repositories.idempotency import IdempotencyKey, IdempotencyStore, StoredResponse
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scanner_lease_and_stop import EmergencyStopped, ScannerRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import DesiredScanState, ScanState

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
    for repository in (MaskRepository, PlanRepository, ScanRepository, BatchRepository):
        with pytest.raises(NotFound, match=f"no {repository.kind} 'nope'"):
            repository(database).get("nope")


def test_scan_row_records_state_history_and_times(scans, scan, clock):
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


def test_interrupt_all_changes_only_scans_in_progress(scans, plan_row):
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


def test_scanner_stop_with_overlong_actor_name_is_recorded(rows):
    """PostgreSQL keeps to the lengths of its columns."""
    scanners = ScannerRepository(rows)
    scanners.ensure(simulated=True)
    scanners.stop(f"key {'a' * 200} (0123456789ab)", "smoke")
    noted = scanners.get(scanners.id)
    assert (noted.stop_reason, noted.stopped_by[:7]) == ("smoke", "key aaa")


def test_a_scanner_s_node_has_to_do_with_its_own_scans_alone(database, clock, plan_row, scans):
    scanners = [ScannerRepository(database, clock, name) for name in ("scanner-0", "scanner-1")]
    for scanner in scanners:
        scanner.ensure(simulated=True)
    other = ScanRepository(database, clock, "scanner-1")
    mine, theirs = [scans.queue(plan_row, simulated=True) for _ in range(2)], other.queue(plan_row, simulated=True)
    assert (scans.next_queued().id, other.next_queued().id) == (mine[0].id, theirs.id)
    lead(scans, mine[0], S.ARMING, S.RUNNING)
    lead(other, theirs, S.ARMING, S.RUNNING)
    scanners[1].stop("Ada", "smoke")
    wishes = [scans.get(scan.id).desired_state for scan in (*mine, theirs)]
    assert wishes == [DesiredScanState.RUNNING] * 2 + [DesiredScanState.ABORTED]
    assert scanners[0].refusal_reason(scans.get(mine[1].id)) is None
    with pytest.raises(EmergencyStopped), database.write() as session:
        scanners[1].check_fence(session, None, "Ada")
    assert scanners[0].lease("Ada", 60, None, "ada").fence == scanners[1].lease("Ben", 60, None, "ben").fence == 1
    assert other.interrupt_all("restart") == [theirs.id]
    assert scans.get(mine[0].id).state is S.RUNNING


def test_desired_state_can_be_repeated_but_not_set_on_finished_scan(scans, scan):
    scans.set_desired_state(scan.id, DesiredScanState.STOPPED, "enough")
    scans.set_desired_state(scan.id, DesiredScanState.STOPPED, "again")
    assert scans.get(scan.id).reason == "enough"
    lead(scans, scan, S.ARMING, S.FAILED)
    with pytest.raises(Conflict, match="it has ended"):
        scans.set_desired_state(scan.id, DesiredScanState.ABORTED, None)


def test_a_repeated_key_gets_the_same_answer_for_a_day(database, clock):
    made = []

    def make(_session):
        made.append(len(made))
        return StoredResponse(201, f"/{made[-1]}", "{}")

    answers, key = IdempotencyStore(database, clock), IdempotencyKey("ada", "/scans", "k", "b")
    first = answers.run_once(key, make)
    assert (first.location, first.replayed) == ("/0", False)
    again = answers.run_once(key, make)
    assert (again.location, again.replayed) == ("/0", True)
    with pytest.raises(InvalidInput, match="Idempotency-Key"):
        answers.run_once(replace(key, body_hash="other"), make)
    assert answers.run_once(replace(key, principal="bob"), make).location == "/1"
    clock.advance(hours=25)
    assert answers.run_once(key, make).location == "/2"
    assert answers.run_once(None, make).location == "/3"


def test_a_request_that_is_answered_beside_the_same_one_is_neither_done_twice_nor_forgotten(rows):
    key = IdempotencyKey("ada", "/scans", "k", "b")

    class Late(IdempotencyStore):
        """Looks for an answer just before another node gives it."""

        is_first = True

        def _replay(self, session, key):
            kept = super()._replay(session, key)
            if self.is_first:
                self.is_first = False
                IdempotencyStore(rows).run_once(key, lambda _: StoredResponse(201, "/other", "{}"))
            return kept

    late = Late(rows).run_once(key, lambda _: StoredResponse(201, "/own", "{}"))
    assert (late.location, late.replayed) == ("/other", True)


def test_pages_show_every_row_once_newest_first(scans, plan_row):
    made = [scans.queue(plan_row, simulated=True).id for _ in range(5)]
    seen, before = [], None
    while True:
        page = scans.page(2, before)
        seen += [row.id for row in page.rows]
        if (before := page.cursor) is None:
            break
    assert seen == made[::-1]
