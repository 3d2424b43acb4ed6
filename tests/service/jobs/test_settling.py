"""Where ledger and engine disagree the service settles it, and what somebody asked for meanwhile holds."""

import pytest
from sqlalchemy import text

from steradian.jobs.job import JobRequest, Requirements
from steradian.jobs.queue.fair_queueing import TAG_LIMIT
from steradian.jobs.queue.matching import Capabilities, WorkerRegistration
from steradian.jobs.registry import LIVE_KIND
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ReconstructionState, ScanState

R = ReconstructionState


@pytest.fixture
def idle(tmp_path, make_bench):
    """A queue without a worker."""
    bench = make_bench(tmp_path)
    yield bench
    bench.close()


def in_engine(bench, statement):
    with bench.queue.ledger.database.write() as session:
        return session.execute(text(statement))


@pytest.mark.long
def test_a_job_that_the_engine_has_given_up_is_not_left_running(idle):
    """As after a full disk, where the engine noted its end and the ledger could not."""
    idle.submit("lost", "succeed", answer=1)
    idle.queue.ledger.start_attempt("lost", "worker-0")
    in_engine(idle, "UPDATE workflow_status SET status = 'ERROR' WHERE workflow_uuid = 'lost'")
    seen = []
    for _ in range(2):
        idle.queue.reconcile()
        seen.append(idle.queue.status("lost").state)
    assert seen == [R.RUNNING, R.QUEUED], "what is seen once may be under way"
    idle.start()
    job = idle.queue.wait("lost", timeout=250)
    assert (job.state, job.result) == (R.SUCCEEDED, {"answer": 1})
    assert [start["outcome"] for start in job.attempts] == ["died", "succeeded"]


def test_a_priority_that_is_changed_while_a_job_is_given_to_the_engine_is_the_engines_too(idle):
    ledger = idle.queue.ledger
    with ledger.database.write() as session:
        ledger.add(session, JobRequest("early", "echo", {}))  # the queue was not open yet
    (seen,) = ledger.unfinished()
    idle.queue.set_priority("early", 7)
    idle.queue._settle(seen, None)
    found = in_engine(idle, "SELECT priority FROM workflow_status WHERE workflow_uuid = 'early'")
    assert found.scalar_one() // TAG_LIMIT == 7


QUEUED_IN = "SELECT queue_name FROM workflow_status WHERE workflow_uuid = :job"


@pytest.fixture
def growing(idle):
    """Queues an image that grows with a scan, whose scanner's node has workers."""
    ledger = idle.queue.ledger
    ScannerRepository(ledger.database).ensure(simulated=True, follows=True)
    mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=60)
    plan = ScanPlan.create(mask=mask, samples=256)
    MaskRepository(ledger.database).put(mask)
    scans = ScanRepository(ledger.database)
    scan = scans.queue(PlanRepository(ledger.database).put(plan)[0], simulated=True)
    for state in (ScanState.ARMING, ScanState.RUNNING):
        scans.transition(scan.id, state, why="test")

    def queue(name, **requires):
        payload = {"kind": LIVE_KIND, "scan_id": scan.id}
        idle.queue.submit(JobRequest(name, LIVE_KIND, payload, requires=Requirements(**requires)))
        return name

    return queue


def queue_of(bench, job):
    with bench.queue.ledger.database.read() as session:
        return session.execute(text(QUEUED_IN), {"job": job}).scalar_one()


def test_an_image_that_waits_for_a_scanner_s_own_workers_is_anybody_s_where_its_node_comes_back_without(idle, growing):
    job = growing("growing")
    assert queue_of(idle, job) == "jobs-scanner-0"
    idle.queue.reconcile()
    assert queue_of(idle, job) == "jobs-scanner-0", "its node has workers"
    ScannerRepository(idle.queue.ledger.database).ensure(simulated=True, follows=False)
    idle.queue.reconcile()
    assert queue_of(idle, job) == "jobs"


def test_an_image_that_a_scanner_s_own_workers_cannot_make_is_anybody_s(idle, growing):
    database = idle.queue.ledger.database
    WorkerRegistration(database, "scanner-0-0", Capabilities(1000, 2, None, "scanner-0")).publish()
    WorkerRegistration(database, "far-0", Capabilities(5000, 2)).publish()
    assert queue_of(idle, growing("small", memory=1000)) == "jobs-scanner-0"
    assert queue_of(idle, growing("large", memory=1001)) == "jobs"


def test_an_image_that_waits_for_workers_which_turn_out_too_small_is_anybody_s(idle, growing):
    job = growing("large", memory=1001)
    assert queue_of(idle, job) == "jobs-scanner-0", "of the workers there nothing is known yet"
    WorkerRegistration(idle.queue.ledger.database, "scanner-0-0", Capabilities(1000, 2, None, "scanner-0")).publish()
    idle.queue.reconcile()
    assert queue_of(idle, job) == "jobs"
