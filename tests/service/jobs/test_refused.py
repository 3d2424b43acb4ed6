"""What becomes of a job whose row the database refuses to change, has lost, or has in an earlier state."""

import asyncio
import os
import sys
from pathlib import Path

import pytest
from sqlalchemy import text

from steradian.jobs.job import JobRequest, Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.jobs.worker.runner import JobRunner
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.state_machines import ReconstructionState
from support.waiting import until

R = ReconstructionState


def told(bench, statement):
    with bench.queue.ledger.database.write() as session:
        session.execute(text(statement))


@pytest.mark.long
def test_a_result_that_the_database_refuses_fails_its_job_and_is_not_offered_for_ever(bench):
    told(
        bench,
        "CREATE TRIGGER refuse BEFORE UPDATE ON jobs WHEN NEW.id = 'refused' AND NEW.state = 'succeeded'"
        " BEGIN SELECT RAISE(ABORT, 'no such result, please'); END",
    )
    bench.submit("refused", "succeed", answer=1)
    status = bench.queue.wait("refused", timeout=250)
    assert (status.state, status.attempt, status.error_code) == (R.FAILED, 1, "internal")
    assert status.error == "the database rejects its result: no such result, please"


@pytest.mark.long
def test_result_is_kept_while_postgresql_is_read_only(tmp_path, postgres, make_bench):
    bench = make_bench(tmp_path, database_url=postgres.database())
    told(
        bench,
        "CREATE FUNCTION refuse() RETURNS trigger LANGUAGE plpgsql AS"
        " $$ BEGIN RAISE 'only reads' USING ERRCODE = 'read_only_sql_transaction'; END $$",
    )
    told(
        bench,
        "CREATE TRIGGER refuse BEFORE UPDATE ON jobs FOR EACH ROW"
        " WHEN (NEW.id = 'early' AND NEW.state IN ('succeeded', 'failed')) EXECUTE FUNCTION refuse()",
    )
    bench.start()
    try:
        bench.submit("early", "succeed", answer=1)
        until(lambda: "only reads" in bench.log.read_text())
        told(bench, "DROP TRIGGER refuse ON jobs")
        status = bench.queue.wait("early", timeout=250)
        assert (status.state, status.attempt, status.result) == (R.SUCCEEDED, 1, {"answer": 1})
        assert [start["outcome"] for start in status.attempts] == ["succeeded"]
    finally:
        bench.close()


@pytest.mark.long
def test_job_with_deleted_row_ends_and_next_job_runs(bench):
    bench.submit("gone", "hang")
    pid = bench.until_working("gone")
    told(bench, "DELETE FROM jobs WHERE id = 'gone'")
    bench.submit("next", "succeed", answer=2)
    assert bench.queue.wait("next", timeout=250).result == {"answer": 2}
    until(lambda: not os.path.exists(f"/proc/{pid}"))
    said = bench.log.read_text()
    assert "there is no job 'gone' any more" in said
    assert "Traceback" not in said.partition("'gone'")[2], said


@pytest.mark.long
def test_settling_deleted_job_does_not_block_other_jobs(bench):
    bench.submit("there", "succeed", answer=3)
    row = bench.queue.ledger.get("there")
    row.id = "deleted"
    bench.queue._settle(row, "ERROR")
    row.state = R.CANCELLING
    bench.queue._settle(row, None)
    assert bench.queue.wait("there", timeout=250).state is R.SUCCEEDED


def test_attempt_number_continues_from_folder_after_database_restore(bench):
    """Else each would be taken for one of before, which the later ones in the folder have overtaken."""
    job = DataDirectory(bench.settings.data).job("restored")
    job.begin_attempt(7)
    bench.submit("restored", "tell")
    status = bench.queue.wait("restored", timeout=250)
    assert (status.state, status.result, status.attempt) == (R.SUCCEEDED, {"start": 8}, 1)
    job.begin_attempt(8)


def test_empty_attempt_file_does_not_block_job(bench):
    job = DataDirectory(bench.settings.data).job("emptied")
    job.root.mkdir(parents=True)
    (job.root / "start").write_text("")
    bench.submit("emptied", "tell")
    assert bench.queue.wait("emptied", timeout=250).result == {"start": 1}
    job.begin_attempt(1)
    job.check_fence(1)


class Overtaken(JobLedger):
    """A ledger in which another worker starts a job in the moment in which this one brings its result."""

    def finish_attempt(self, job_id, fence, outcome, worker):
        JobLedger(self.database).start_attempt(job_id, "other")
        return super().finish_attempt(job_id, fence, outcome, worker)


@pytest.mark.long
def test_a_result_of_a_start_that_was_overtaken_in_that_moment_is_refused_by_the_ledger_alone(make_bench, tmp_path):
    """No lock, no look at the job and no file is in its way."""
    bench = make_bench(tmp_path)
    ledger = bench.queue.ledger
    with ledger.database.write() as session:
        about = {"do": "succeed", "answer": "old", "diary": str(tmp_path / "diary")}
        ledger.add(session, JobRequest("job", "echo", about))
    echo = {"echo": [sys.executable, str(Path(__file__).with_name("echo_job.py"))]}
    runner = JobRunner(bench.settings, Overtaken(ledger.database), echo, "cut-off")

    async def run():
        try:
            return await runner.run("job")
        finally:
            await runner._processes["echo"].end()

    assert asyncio.run(run()) == R.RUNNING
    status = ledger.status("job")
    assert (status.state, status.result, status.attempt) == (R.RUNNING, {}, 2)
    assert [(start["worker"], start["outcome"]) for start in status.attempts] == [("cut-off", "died"), ("other", None)]
    ledger.finish_attempt("job", 2, Succeeded({"answer": "new"}), "other")
    assert ledger.status("job").result == {"answer": "new"}
    bench.queue.close()


@pytest.mark.long
def test_a_job_that_comes_while_the_worker_is_asked_to_end_is_not_begun(make_bench, tmp_path):
    """Its process ends without waiting for it: a start would be left behind that counts as dead."""
    bench = make_bench(tmp_path)
    bench.submit("late", "succeed", answer="none")
    runner = JobRunner(bench.settings, bench.queue.ledger, {}, "ending")
    runner.stopping.set()
    runner.idle.clear()

    async def come():
        run = asyncio.ensure_future(runner.run("late"))
        await asyncio.to_thread(until, runner.idle.is_set)
        run.cancel()
        await asyncio.wait({run})

    asyncio.run(come())
    status = bench.queue.status("late")
    assert (status.state, status.attempt, status.attempts) == (R.QUEUED, 0, [])
    bench.close()
