"""A worker that is asked to end finishes its job, where it is given the time, and begins no other."""

import psycopg
import pytest

from steradian.storage.state_machines import ReconstructionState
from support.waiting import until


@pytest.fixture
def bench(tmp_path, make_bench):
    bench = make_bench(tmp_path, drain_seconds=200)
    bench.start()
    yield bench
    bench.close()


@pytest.mark.long
def test_a_worker_finishes_its_job_and_leaves_the_next_to_others(bench):
    bench.submit("first", "succeed", answer=1, seconds=1)
    bench.submit("second", "succeed", answer=2)
    bench.until_working("first")
    bench.worker.terminate()
    assert bench.worker.wait(250) == 0
    first, second = (bench.queue.status(name) for name in ("first", "second"))
    assert (first.state, len(bench.starts("first"))) == (ReconstructionState.SUCCEEDED, 1)
    assert (second.state, second.attempt, bench.starts("second")) == (ReconstructionState.QUEUED, 0, [])
    bench.start()
    until(lambda: bench.queue.status("second").state is ReconstructionState.SUCCEEDED)


ALIVE = (
    "SELECT EXISTS (SELECT FROM pg_locks JOIN pg_stat_activity USING (pid)"
    " WHERE locktype = 'advisory' AND granted AND state = 'idle' AND datname = current_database()"
    " AND state_change > %s)"
)
"""Whether a session that holds a name has asked something since a time."""


@pytest.mark.long
def test_a_worker_that_finishes_its_job_shows_life_until_it_has(tmp_path, make_bench, postgres):
    """Who shows none for ten seconds counts as dead: another worker begins its job anew."""
    bench = make_bench(tmp_path, drain_seconds=200, database_url=(url := postgres.database()))
    try:
        bench.start()
        bench.submit("long", "wait", answer=1, until=str(tmp_path / "go on"))
        bench.until_working("long")
        with psycopg.connect(url, autocommit=True) as server:
            bench.worker.terminate()
            later = server.execute("SELECT clock_timestamp() + interval '6 s'").fetchone()  # three looks of a worker
            until(lambda: server.execute(ALIVE, later).fetchone() == (True,))
        (tmp_path / "go on").touch()
        assert bench.worker.wait(250) == 0
        status = bench.queue.status("long")
        assert (status.state, status.attempt) == (ReconstructionState.SUCCEEDED, 1)
    finally:
        bench.close()
