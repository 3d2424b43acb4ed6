"""The queue with a real worker process and real jobs; what a job does stands in ``echo_job.py``."""

import sqlite3
import subprocess
import sys
import time
from contextlib import closing

import pytest

from steradian.core.exceptions import Conflict, NotFound
from steradian.jobs.job import JobRequest
from steradian.jobs.queue.queue_client import JobQueue
from steradian.storage.state_machines import ReconstructionState
from support.processes import are_gone
from support.waiting import until

R = ReconstructionState


@pytest.mark.long
def test_a_job_runs_once_and_leaves_its_result(bench):
    bench.submit("good", "succeed", answer=42)
    bench.submit("good", "succeed", answer=43)
    seen = []
    status = bench.queue.wait("good", timeout=250, progress=lambda *progress: seen.append(progress))
    assert (status.state, status.attempt, status.result) == (R.SUCCEEDED, 1, {"answer": 42})
    assert seen[-1] == ("working", 1, 4)
    assert len(bench.starts("good")) == 1
    assert status.created <= status.started <= status.ended


@pytest.mark.long
def test_all_workers_of_a_service_together_fill_the_machine_once(make_bench, tmp_path):
    bench = make_bench(tmp_path, workers=64)
    try:
        bench.start()
        bench.submit("counted", "count threads")
        assert bench.queue.wait("counted", timeout=250).result == {"threads": bench.settings.threads_per_job}
    finally:
        bench.close()


@pytest.mark.long
def test_a_job_that_states_its_error_fails_at_once_with_it(bench):
    bench.submit("bad", "fail")
    status = bench.queue.wait("bad", timeout=250)
    assert (status.state, status.attempt) == (R.FAILED, 1)
    assert (status.error_code, status.error) == ("invalid-input", "depth is -1; allowed: > 0 (m)")


@pytest.mark.long
def test_job_that_meets_a_full_disk_fails_with_the_code_of_the_problem(bench):
    bench.submit("full", "fill")
    status = bench.queue.wait("full", timeout=250)
    assert (status.state, status.attempt, status.error_code) == (R.FAILED, 1, "disk-full")
    assert "No space left on device" in status.error


def test_a_job_that_crashes_fails_at_once_and_its_log_has_the_traceback(bench):
    bench.submit("crash", "crash")
    status = bench.queue.wait("crash", timeout=250)
    assert (status.state, status.attempt, status.error) == (R.FAILED, 1, "ZeroDivisionError: oh")
    log = (bench.settings.data / "jobs" / "crash" / "log.txt").read_text()
    assert "ZeroDivisionError: oh" in log
    assert 'raise ZeroDivisionError("oh")' in log


def test_killed_job_process_is_retried_three_times_then_fails(bench):
    bench.submit("poison", "die")
    status = bench.queue.wait("poison", timeout=250)
    assert (status.state, status.attempt, status.error_code) == (R.FAILED, 3, "died")
    assert "SIGKILL" in status.error
    assert len(bench.starts("poison")) == 3


def test_cancelling_a_running_job_kills_its_process_within_a_second(bench, slowed):
    bench.submit("long", "hang")
    pid = bench.until_working("long")
    start = time.monotonic()
    assert bench.queue.cancel("long").state in {R.CANCELLING, R.CANCELLED}
    until(lambda: are_gone([pid]))
    took = time.monotonic() - start
    assert took < 1 * slowed()
    assert bench.queue.wait("long", timeout=250).state is R.CANCELLED
    assert bench.queue.cancel("long").state is R.CANCELLED
    bench.submit("after", "succeed", answer=1)
    assert bench.queue.wait("after", timeout=250).state is R.SUCCEEDED


def test_a_job_cancelled_before_its_turn_never_starts(bench):
    bench.submit("front", "hang")
    bench.until_working("front")
    bench.submit("waiting", "succeed", answer=1)
    assert bench.queue.status("waiting").state is R.QUEUED
    assert bench.queue.cancel("waiting").state is R.CANCELLED
    bench.queue.cancel("front")
    assert bench.queue.wait("front", timeout=250).state is R.CANCELLED
    assert bench.starts("waiting") == []


def test_smaller_priorities_run_first_and_a_waiting_job_can_be_moved(bench):
    bench.submit("busy", "hang")
    bench.until_working("busy")
    for name, priority in (("late", 900), ("usual", 100), ("moved", 901), ("early", 5)):
        payload = {"do": "succeed", "answer": 1, "diary": str(bench.settings.data / name)}
        bench.queue.submit(JobRequest(name, "echo", payload, priority=priority))
    assert bench.queue.set_priority("moved", 1).priority == 1
    bench.queue.cancel("busy")
    jobs = [bench.queue.wait(name, timeout=250) for name in ("moved", "early", "usual", "late")]
    assert [job.started for job in jobs] == sorted(job.started for job in jobs)
    with pytest.raises(Conflict, match="only a queued one"):
        bench.queue.set_priority("moved", 7)


def test_job_process_is_reused_until_a_failure(bench):
    for name, do in (("first", "succeed"), ("second", "succeed"), ("third", "crash"), ("fourth", "succeed")):
        bench.submit(name, do, answer=1)
        bench.queue.wait(name, timeout=250)
    first, second, third, fourth = (bench.starts(name)[0] for name in ("first", "second", "third", "fourth"))
    assert first == second == third != fourth


def test_a_job_that_takes_too_long_is_killed_and_has_failed(bench):
    payload = {"do": "hang", "diary": str(bench.settings.data / "slow")}
    bench.queue.submit(JobRequest("slow", "echo", payload, timeout=0.5))
    status = bench.queue.wait("slow", timeout=250)
    assert (status.state, status.error_code, status.attempt) == (R.FAILED, "timeout", 1)
    assert are_gone([bench.starts("slow")[0]])


def test_every_attempt_and_state_change_is_recorded(bench):
    bench.submit("mortal", "die")
    status = bench.queue.wait("mortal", timeout=250)
    assert [(a["number"], a["worker"], a["outcome"]) for a in status.attempts] == [
        (number, "worker-0", "died") for number in (1, 2, 3)
    ]
    assert all(a["started"] <= a["ended"] for a in status.attempts)
    states = [entry["state"] for entry in status.history]
    assert states == ["queued", "running", "queued", "running", "queued", "running", "failed"]
    assert {entry["who"] for entry in status.history} == {"local", "worker-0"}
    assert all(entry["at"] and entry["why"] for entry in status.history)


def test_a_finished_job_cannot_be_cancelled_and_an_unknown_one_is_named(bench):
    bench.submit("done", "succeed", answer=1)
    bench.queue.wait("done", timeout=250)
    with pytest.raises(Conflict, match="done has succeeded"):
        bench.queue.cancel("done")
    with pytest.raises(NotFound, match="no job 'nope'"):
        bench.queue.status("nope")


@pytest.mark.long
def test_a_killed_workers_job_ends_with_it_and_is_started_again(bench):
    bench.submit("orphan", "hang")
    pid = bench.until_working("orphan")
    bench.worker.kill()
    bench.worker.wait()
    until(lambda: are_gone([pid]))
    bench.start()
    bench.until_working("orphan", attempt=2)
    assert bench.queue.status("orphan").attempt == 2


@pytest.mark.long
def test_a_worker_that_is_asked_to_end_puts_its_job_back_without_counting_it(bench, slowed):
    bench.submit("back", "hang")
    if bench.queue.status("orphan").state is R.RUNNING:
        bench.queue.cancel("orphan")
    pid = bench.until_working("back")
    start = time.monotonic()
    bench.worker.terminate()
    assert bench.worker.wait(250) == 0
    took = time.monotonic() - start
    assert took < 5 * slowed()
    assert are_gone([pid])
    bench.start()
    bench.until_working("back", attempt=2)
    assert bench.queue.status("back").attempt == 1
    bench.queue.cancel("back")


@pytest.mark.long
@pytest.mark.parametrize("expression", ["unixepoch('subsec') * 1000", "strftime('%s','now') * 1000"])
def test_a_queue_made_by_any_python_is_used_by_this_one(tmp_path, make_bench, expression):
    """The engine writes the one from Python 3.12 on and the other before; SQLite knows the first from 3.42 on."""
    bench = make_bench(tmp_path)
    with closing(sqlite3.connect(bench.settings.data / "steradian.sqlite")) as file, file:
        file.execute("PRAGMA writable_schema = ON")
        for usual in ("unixepoch('subsec') * 1000", "strftime('%s','now') * 1000"):
            file.execute("UPDATE sqlite_master SET sql = replace(sql, ?, ?)", (usual, expression))
    bench.queue.close()
    bench.queue = JobQueue(bench.settings)
    bench.start()
    try:
        before = time.time()
        bench.submit("timed", "succeed", answer=1)
        assert bench.queue.wait("timed", timeout=250).state is R.SUCCEEDED
    finally:
        bench.close()
    after = time.time()  # the engine notes a job's end after the ledger does
    with closing(sqlite3.connect(bench.settings.data / "steradian.sqlite")) as plain:
        ((schema,),) = plain.execute("SELECT sql FROM sqlite_master WHERE name = 'workflow_status'")
        assert schema.count(expression) == 2
        assert plain.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        ((created, updated),) = plain.execute("SELECT created_at, updated_at FROM workflow_status")
    assert int(before) * 1000 <= created <= updated <= (after + 0.001) * 1000


@pytest.mark.long
def test_importing_job_model_does_not_load_dbos():
    code = "import steradian.jobs.job, steradian.api.services, sys; print('dbos' in sys.modules)"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "False"
