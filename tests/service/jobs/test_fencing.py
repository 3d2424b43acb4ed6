"""A start of a job that is not its newest changes nothing: not the ledger, not the files."""

import os
from pathlib import Path

import filelock
import pytest

from steradian.core.atomic_files import atomic_write, fenced_drafts
from steradian.core.exceptions import StaleFence
from steradian.jobs.job import MAX_INTERRUPTIONS, Crashed, JobRequest, Requeued, Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.storage.data_dir.job_directory import JobDirectory
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.state_machines import ReconstructionState
from support.waiting import until

R = ReconstructionState


@pytest.fixture
def ledger(tmp_path):
    database = Database(f"sqlite:///{tmp_path / 'test.sqlite'}")
    database.migrate()
    ledger = JobLedger(database)
    with database.write() as session:
        ledger.add(session, JobRequest("job", "echo", {}))
    yield ledger
    database.close()


def seen(ledger):
    status = ledger.status("job")
    return status.state, status.attempt, status.stage, status.done, [a["outcome"] for a in status.attempts]


@pytest.mark.parametrize(
    "change",
    [
        lambda ledger, old: ledger.finish_attempt("job", old, Succeeded({"of": "the old one"}), "cut-off"),
        lambda ledger, old: ledger.finish_attempt("job", old, Crashed("killed"), "cut-off"),
        lambda ledger, old: ledger.requeue("job", old, "cut-off"),
        lambda ledger, old: ledger.report("job", old, "working", 3, 4),
        lambda ledger, old: ledger.cancelled("job", "cut-off", old),
    ],
    ids=["success", "death", "put back", "progress", "cancelled"],
)
@pytest.mark.parametrize("wanted", [True, False], ids=["wanted", "unwanted"])
def test_stale_fence_update_is_refused(ledger, change, wanted):
    old = ledger.start_attempt("job", "cut-off").fence
    new = ledger.start_attempt("job", "other").fence
    if not wanted:
        ledger.request_cancellation("job", "somebody", None)
    before = seen(ledger)
    with pytest.raises(StaleFence, match=f"start {old} of job job counts no more"):
        change(ledger, old)
    assert seen(ledger) == before
    ledger.finish_attempt("job", new, Succeeded({"of": "the new one"}), "other")
    assert ledger.status("job").state is (R.SUCCEEDED if wanted else R.CANCELLED)


def test_a_number_is_not_used_again_after_a_start_was_put_back(ledger):
    """The count of attempts goes back, the number does not: else the one before would pass for the one after."""
    old = ledger.start_attempt("job", "asked-to-end")
    ledger.requeue("job", old.fence, "asked-to-end")
    new = ledger.start_attempt("job", "other")
    assert (old.attempt, new.attempt) == (1, 1)
    assert new.fence > old.fence
    with pytest.raises(StaleFence):
        ledger.finish_attempt("job", old.fence, Succeeded({}), "asked-to-end")
    assert [(a["start"], a["outcome"]) for a in ledger.status("job").attempts] == [(1, "put back"), (2, None)]


def test_interruptions_are_not_counted_as_attempts_but_do_not_go_on_for_ever(ledger):
    for _ in range(MAX_INTERRUPTIONS - 1):
        row = ledger.finish_attempt(
            "job", ledger.start_attempt("job", "one").fence, Requeued("the folder is gone"), "one"
        )
        assert (row.state, row.attempt) == (R.QUEUED, 0)
    row = ledger.finish_attempt("job", ledger.start_attempt("job", "one").fence, Requeued("the folder is gone"), "one")
    assert (row.state, row.error_code) == (R.FAILED, "interrupted")
    assert "the folder is gone" in row.error


def test_two_starts_never_write_into_one_draft_and_the_old_one_does_not_rename_over_the_new_ones_result(tmp_path):
    job, result = JobDirectory(tmp_path), tmp_path / "volume.h5"

    def of(start):
        return fenced_drafts(str(start), lambda: job.check_fence(start))

    def overtaken():
        with of(1), atomic_write(result) as old:
            old.write_text("old")
            job.begin_attempt(2)
            with of(2), atomic_write(result) as new:
                assert new != old
                new.write_text("new")
            assert result.read_text() == "new"

    job.begin_attempt(1)
    with pytest.raises(StaleFence, match=r"start 1 of job .* start 2 has begun"):
        overtaken()
    assert result.read_text() == "new"
    assert {path.name for path in tmp_path.iterdir()} == {"volume.h5", "start"}
    with pytest.raises(StaleFence):
        job.begin_attempt(1)


def test_a_start_removes_the_drafts_that_killed_ones_left(tmp_path):
    (tmp_path / "volume.h5.1.new").write_text("half")
    (tmp_path / ".export.1.new.zarr").mkdir()
    with JobDirectory(tmp_path).hold_running_lock():
        assert {path.name for path in tmp_path.iterdir()} == {"lock"}


@pytest.mark.long
def test_a_job_that_an_earlier_start_is_still_at_is_put_back(bench):
    folder = DataDirectory(bench.settings.data).job("locked")
    folder.root.mkdir(parents=True)
    with filelock.FileLock(folder.root / "lock"):
        bench.submit("locked", "lock", answer=1)
        until(lambda: "interrupted" in [a["outcome"] for a in bench.queue.status("locked").attempts])
    status = bench.queue.wait("locked", timeout=250)
    assert (status.state, status.attempt, status.error) == (R.SUCCEEDED, 1, None)
    assert "still runs job locked" in status.attempts[0]["detail"]


@pytest.mark.long
def test_job_with_unwritable_log_fails_after_three_attempts(bench):
    """As on a full disk: the worker wants to note why the process died, and cannot."""
    log = DataDirectory(bench.settings.data).job("full").log
    log.parent.mkdir(parents=True)
    log.symlink_to("/dev/full")
    bench.submit("full", "die")
    status = bench.queue.wait("full", timeout=250)
    assert (status.state, status.attempt, status.error_code) == (R.FAILED, 3, "died")


@pytest.mark.long
@pytest.mark.parametrize(
    ("lost", "said"),
    [("stale", "Stale file handle"), ("away", "unable to open database file")],
    ids=["files", "database"],
)
def test_a_lost_file_system_or_database_interrupts_a_job(bench, lost, said):
    bench.submit(lost, lost, answer=1)
    status = bench.queue.wait(lost, timeout=250)
    assert (status.state, status.attempt) == (R.SUCCEEDED, 1)
    assert [a["outcome"] for a in status.attempts] == ["interrupted", "succeeded"]
    assert said in status.attempts[0]["detail"]


@pytest.mark.long
def test_the_newest_start_survives_in_the_folder(tmp_path):
    job = JobDirectory(tmp_path / "job")
    job.begin_attempt(3)
    assert os.listdir(job.root) == ["start"]
    job.check_fence(3)
    assert Path(job.root / "start").read_text() == "3"
