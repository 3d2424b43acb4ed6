"""Workers that are cut off and come back, locks that are held, submissions that are killed: each job ends once."""

import os
import signal
import subprocess
import sys

import filelock
import pytest

from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.state_machines import ReconstructionState, is_terminal
from support.proxy import Proxy

pytestmark = [pytest.mark.crash, pytest.mark.timeout(180)]
R = ReconstructionState
SUBMIT = """
import os, signal, sys
from sqlalchemy import event
from steradian.jobs.queue.queue_client import JobQueue
from steradian.jobs.job import JobRequest
from steradian.core.settings import Settings
moment, name, folder = sys.argv[1:]
queue = JobQueue(Settings.create())
kill = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
if moment == "between":  # the job's row is written, the engine has not been given it
    event.listen(queue._database.engine, "after_cursor_execute",
                 lambda c, cursor, statement, *_: kill() if statement.startswith("INSERT INTO jobs") else None)
queue.submit(JobRequest(name, "echo", {"do": "succeed", "answer": 1, "diary": folder + "/" + name}))
kill()
"""


@pytest.fixture
def two_hosts(distributed):
    """A service and a worker of another host, which reaches the database through a proxy; yields both and the proxy."""
    proxy = Proxy(distributed.settings.database_url)
    distributed.start()
    distributed.start_worker(worker_name="other", database_url=proxy.url)
    distributed.until(lambda: (distributed.folder / "run" / "other-0.json").exists(), 60)
    yield distributed, proxy
    proxy.close()


def running_on_the_other(service):
    """Queue jobs until the other host runs one; returns their names and that one's."""
    names = [service.submit(f"job-{number}", "tell", seconds=10 if number < 2 else 0.1) for number in range(3)]
    found = {}

    def look():
        for name in names[:2]:
            starts = service.queue.status(name).attempts
            if starts and starts[-1]["worker"] == "other-0":
                found["name"] = name
        return bool(found)

    service.until(look, 60)
    name = found["name"]
    service.until(lambda: service.queue.status(name).stage == "working", 60)
    return names, name


def ends(service, name):
    history = service.queue.status(name).history
    return [entry["state"] for entry in history if is_terminal(R(entry["state"]))]


def taken_over(service, names, name):
    """Check that the newest start alone ended the job, whatever the one before had to say."""
    service.until(lambda: all(service.queue.status(other).is_over for other in names), 90)
    job = service.queue.status(name)
    assert [ends(service, other) for other in names] == [["succeeded"]] * len(names)
    assert [(a["worker"], a["outcome"]) for a in job.attempts] == [("other-0", "died"), ("worker-0", "succeeded")]
    assert job.result == {"start": job.attempts[-1]["start"]}


def test_a_stopped_worker_that_comes_back_changes_nothing(two_hosts):
    service, _proxy = two_hosts
    names, name = running_on_the_other(service)
    pid = service.pid_of("other-0")
    os.kill(pid, signal.SIGSTOP)
    try:
        service.until(lambda: service.queue.status(name).attempts[-1]["worker"] == "worker-0", 90)
    finally:
        os.kill(pid, signal.SIGCONT)
    taken_over(service, names, name)


def test_disconnected_worker_changes_nothing_after_reconnecting(two_hosts):
    service, proxy = two_hosts
    names, name = running_on_the_other(service)
    proxy.cut()
    service.until(lambda: service.queue.status(name).attempts[-1]["worker"] == "worker-0", 90)
    proxy.mend()
    taken_over(service, names, name)


def test_job_with_held_lock_is_requeued(service):
    service.start()
    job = DataDirectory(service.folder).job("locked")
    job.root.mkdir(parents=True)
    with filelock.FileLock(job.root / "lock"):
        service.submit("locked", "lock", answer=1)
        service.until(lambda: "interrupted" in [a["outcome"] for a in service.queue.status("locked").attempts], 60)
    service.until(lambda: service.queue.status("locked").is_over, 60)
    assert ends(service, "locked") == ["succeeded"]
    assert service.queue.status("locked").attempt == 1


def test_a_submission_that_is_killed_has_happened_or_not(service):
    """Without an API that looks after the queue: what is in the ledger, a worker does."""
    assert service.queue
    for moment in ("between", "after"):
        command = [sys.executable, "-c", SUBMIT, moment, moment, str(service.folder)]
        done = subprocess.run(command, env=service.settings.environment(), timeout=120)
        assert done.returncode == -signal.SIGKILL
    jobs = [row.id for row in service.queue.ledger.unfinished()]
    assert jobs == ["after"]
    service.start()
    service.until(lambda: service.queue.status("after").is_over, 60)
    assert ends(service, "after") == ["succeeded"]
    assert len(service.starts("after")) == 1
