"""A data folder that is not mounted any more: no job fails for it, and readiness says so."""

import pytest

from steradian.storage.state_machines import ReconstructionState
from support.waiting import until

pytestmark = pytest.mark.long

R = ReconstructionState


@pytest.fixture
def mounted(tmp_path, postgres, make_bench):
    """A queue in PostgreSQL, and a name under which its folder is mounted."""
    mount, empty = tmp_path / "mount", tmp_path / "empty"
    (tmp_path / "there").mkdir()
    (empty / "scans").mkdir(parents=True)
    mount.symlink_to(tmp_path / "there")
    bench = make_bench(mount, database_url=postgres.database())
    bench.log = tmp_path / "worker.log"
    (mount / "scans" / "s1.h5").write_bytes(b"A-lines")

    def turn(to):
        beside = tmp_path / "beside"
        beside.symlink_to(tmp_path / to)
        beside.rename(mount)

    bench.start()
    yield bench, turn
    turn("there")
    bench.close()


def test_jobs_of_a_folder_that_is_not_mounted_go_back_and_are_done_when_it_is(mounted, tmp_path):
    bench, turn = mounted
    diary = {"diary": str(tmp_path / "diary"), "answer": 1}
    bench.submit("under way", "read", until_lost=True, **diary)
    until(lambda: bench.queue.status("under way").stage == "working")
    bench.submit("waiting", "read", until_lost=False, **diary)
    turn("empty")
    until(lambda: bench.worker.poll() is not None)
    assert "is gone; is it mounted?" in bench.log.read_text()
    assert [bench.queue.status(job).state for job in ("under way", "waiting")] == [R.QUEUED] * 2
    assert "there is no scan" in bench.queue.status("under way").attempts[0]["detail"]
    turn("there")
    bench.start()  # as the supervisor does
    for job in ("under way", "waiting"):
        status = bench.queue.wait(job, timeout=250)
        assert (status.state, status.attempt, status.result) == (R.SUCCEEDED, 1, {"answer": 1})


def test_an_idle_worker_fails_no_job_for_it(mounted, tmp_path):
    bench, turn = mounted
    turn("empty")
    bench.submit("late", "read", until_lost=False, diary=str(tmp_path / "diary"), answer=1)
    until(lambda: bench.worker.poll() is not None or bench.queue.status("late").is_over)
    assert bench.queue.status("late").state is R.QUEUED
    turn("there")
    bench.start()
    assert bench.queue.wait("late", timeout=250).state is R.SUCCEEDED
