"""Nobody waits for all that another one has queued."""

from collections import Counter
from datetime import UTC, datetime

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sqlalchemy import select

from steradian.jobs.forecast import forecast
from steradian.jobs.ledger import JobLedger
from steradian.jobs.model import JobRequest, Succeeded
from steradian.jobs.turns import ORDER, place
from steradian.settings import Settings
from steradian.storage.database import Database, metadata_url
from steradian.storage.paths import DataDirectory
from steradian.storage.states import ReconstructionState
from steradian.storage.tables import JobRow

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
    ledger.settle(job_id, ledger.get(job_id).fence, Succeeded({}), "worker")


@settings(max_examples=12, deadline=None)
@given(st.data())
def test_who_has_jobs_waiting_is_served_as_often_as_any_other_who_has(ledger, data):
    """Start-time fair queueing: while two have jobs waiting, one begins at most two more than the other."""
    names = ("anna", "ben", "carla")
    begun, together, running, number = Counter(), {}, [], Counter()
    workers = data.draw(st.integers(1, 3))
    for _ in range(60):
        waiting = Counter(row.owner for row in _waiting(ledger))
        for pair in (pair for one in names for other in names if (pair := (one, other)) and one < other):
            if waiting[pair[0]] and waiting[pair[1]]:
                since = together.setdefault(pair, begun.copy())
                ahead = (begun[pair[0]] - since[pair[0]]) - (begun[pair[1]] - since[pair[1]])
                assert abs(ahead) <= 1 + workers, (pair, ahead)
            else:
                together.pop(pair, None)
        who = data.draw(st.sampled_from((*names, "anna", "anna", None, None, None)))
        if who is not None:
            number[who] += 1
            with ledger.database.write() as session:
                ledger.add(session, JobRequest(f"{who}-{id(data)}-{number[who]}", "echo", {}, principal=who))
        elif len(running) == workers:
            finish(ledger, running.pop(data.draw(st.integers(0, workers - 1))))
        elif row := next(iter(_waiting(ledger)), None):
            running.append(ledger.start(row.id, "worker").id)
            begun[row.owner] += 1
    for job_id in (*running, *(row.id for row in _waiting(ledger))):
        if ledger.get(job_id).state is ReconstructionState.QUEUED:
            ledger.start(job_id, "worker")
        finish(ledger, job_id)


def _waiting(ledger):
    with ledger.database.read() as session:
        rows = list(session.scalars(WAITING.order_by(*ORDER)))
    assert [place(row) for row in rows] == sorted(place(row) for row in rows), "the engine has the same order"
    return rows


def test_one_alone_is_served_in_the_order_of_asking(ledger):
    asked = [f"alone-{number}" for number in range(30)]
    for name in asked:
        with ledger.database.write() as session:
            ledger.add(session, JobRequest(name, "echo", {}, principal="anna"))
    assert [row.id for row in _waiting(ledger)] == asked
    for name in asked:
        ledger.start(name, "worker")
        finish(ledger, name)


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


def test_those_that_are_moved_to_one_priority_take_turns_there(bench):
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
