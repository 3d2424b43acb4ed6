"""Nobody waits for all that another one has queued."""

from collections import Counter
from datetime import UTC, datetime
from itertools import combinations, count

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sqlalchemy import select

from steradian.core.settings import Settings
from steradian.jobs.job import JobRequest, Succeeded
from steradian.jobs.queue.estimates import forecast
from steradian.jobs.queue.fair_queueing import QUEUE_ORDER, queue_priority
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.jobs.registry import LIVE_KIND
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.db.tables import JobRow
from steradian.storage.state_machines import ReconstructionState

NUMBERS = count()
WAITING = select(JobRow).where(JobRow.state == ReconstructionState.QUEUED)


@pytest.fixture(scope="module")
def ledger(tmp_path_factory):
    """A ledger without an engine: the test takes the jobs."""
    made = Settings.create(data=tmp_path_factory.mktemp("data"))
    DataDirectory(made.data).create()
    database = Database(metadata_url(made))
    database.migrate()
    yield JobLedger(database)
    database.close()


def finish(ledger, job_id):
    ledger.finish_attempt(job_id, ledger.get(job_id).fence, Succeeded({}), "worker")


@pytest.mark.long
@settings(max_examples=12, deadline=None)
@given(st.data())
def test_fair_queueing_serves_waiting_owners_equally(ledger, data):
    """Start-time fair queueing: of two who have jobs of one priority waiting, neither is served much more often."""
    _do_all(ledger)  # what an example that was broken off has left
    owners, priorities = ("anna", "ben", "carla"), (10, 100)
    begun, together, running = Counter(), {}, []
    workers = data.draw(st.integers(1, 3))
    for _ in range(60):
        waiting = Counter((row.owner, row.priority) for row in _waiting(ledger))
        for one, other, priority in ((*pair, priority) for pair in combinations(owners, 2) for priority in priorities):
            both = (one, priority), (other, priority)
            if all(waiting[each] for each in both):
                since = together.setdefault(both, begun.copy())
                ahead = [begun[each] - since[each] for each in both]
                assert abs(ahead[0] - ahead[1]) <= 1 + workers, (both, ahead)
            else:
                together.pop(both, None)
        who = data.draw(st.sampled_from((*owners, "anna", "anna", None, None, None)))
        if who is not None:
            _ask(ledger, who, data.draw(st.sampled_from((10, 100, 100))))
        elif len(running) == workers:
            finish(ledger, running.pop(data.draw(st.integers(0, workers - 1))))
        elif row := next(iter(_waiting(ledger)), None):
            running.append(ledger.start_attempt(row.id, "worker").id)
            begun[row.owner, row.priority] += 1


def _ask(ledger, who, priority=100, kind="echo"):
    with ledger.database.write() as session:
        return ledger.add(session, JobRequest(f"{who}-{next(NUMBERS)}", kind, {}, priority, principal=who)).id


def _do_all(ledger):
    for row in ledger.unfinished():
        if row.state is ReconstructionState.QUEUED:
            ledger.start_attempt(row.id, "worker")
        finish(ledger, row.id)


def _waiting(ledger):
    with ledger.database.read() as session:
        rows = list(session.scalars(WAITING.order_by(*QUEUE_ORDER)))
    assert [queue_priority(row) for row in rows] == sorted(queue_priority(row) for row in rows), (
        "the engine has the same order"
    )
    return rows


def test_one_alone_is_served_in_the_order_of_asking(ledger):
    _do_all(ledger)
    asked = [_ask(ledger, "anna") for _ in range(30)]
    assert [row.id for row in _waiting(ledger)] == asked


@pytest.mark.parametrize("why", ["a job in the background", "a job that was moved ahead", "a live image", "nothing"])
def test_fair_queueing_ignores_other_jobs_of_same_owner(ledger, why):
    """Anna has a batch waiting; whatever else of hers waits or runs, Ben's job has at most one of it before it."""
    _do_all(ledger)
    batch = [_ask(ledger, "anna") for _ in range(20)]
    if why == "a job in the background":
        for _ in range(20):
            _ask(ledger, "ben", 1000)
    elif why == "a job that was moved ahead":
        with ledger.database.write() as session:
            ledger.set_priority(session, batch[-1], 10)
        ledger.start_attempt(batch.pop(), "worker")
    elif why == "a live image":
        ledger.start_attempt(_ask(ledger, "anna", kind=LIVE_KIND), "worker")
    asked = _ask(ledger, "ben")
    assert [row.id for row in _waiting(ledger)].index(asked) <= 1


@pytest.mark.long
def test_the_worker_takes_them_in_turns_and_their_places_say_so(bench):
    bench.submit("busy", "hang")
    bench.until_working("busy")
    for name, who in [*((f"a{number}", "anna") for number in range(4)), ("b0", "ben"), ("b1", "ben")]:
        payload = {"do": "succeed", "answer": 1, "diary": str(bench.settings.data / name)}
        bench.queue.submit(JobRequest(name, "echo", payload, principal=who))
    expected = ["a0", "b0", "a1", "b1", "a2", "a3"]
    with bench.queue.ledger.database.read() as session:
        places = {name: forecast(session, name, 1, datetime.now(UTC)).position for name in expected}
    assert sorted(places, key=places.get) == expected
    bench.queue.cancel("busy")
    jobs = [bench.queue.wait(name, timeout=250) for name in expected]
    assert [job.started for job in jobs] == sorted(job.started for job in jobs)


@pytest.mark.long
def test_jobs_moved_to_same_priority_alternate_between_owners(bench):
    bench.submit("busy again", "hang")
    bench.until_working("busy again")
    for name, who in (("c0", "anna"), ("c1", "anna"), ("c2", "anna"), ("d0", "ben")):
        payload = {"do": "succeed", "answer": 1, "diary": str(bench.settings.data / name)}
        bench.queue.submit(JobRequest(name, "echo", payload, principal=who))
    for name in ("c1", "c2", "d0"):  # all before c0
        bench.queue.set_priority(name, 7)
    bench.queue.cancel("busy again")
    jobs = [bench.queue.wait(name, timeout=250) for name in ("d0", "c1", "c2", "c0")]
    assert [job.started for job in jobs] == sorted(job.started for job in jobs)
