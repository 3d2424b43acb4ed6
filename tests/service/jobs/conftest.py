"""A queue with a real worker process and real jobs; what a job does stands in ``echo_job.py``."""

import subprocess
import sys
from pathlib import Path

import pytest

from steradian.core.settings import Settings
from steradian.jobs.queue.queue_client import JobQueue
from support.echo import EchoQueue
from support.waiting import until

WORKER = """
import sys
from steradian.core.settings import Settings
from steradian.jobs.worker.main import run_worker
run_worker(Settings.create(), 0, {"echo": [sys.executable, sys.argv[1]]})
"""


class Bench(EchoQueue):
    """A queue and its worker."""

    def __init__(self, folder, **settings):
        super().__init__(Settings.create(data=folder, **settings))
        self.queue, self.worker, self.log = JobQueue(self.settings), None, folder / "worker.log"

    def start(self):
        with self.log.open("ab") as log:
            self.worker = self.start_worker(self.settings, log)

    @staticmethod
    def start_worker(settings, log=None):
        command = [sys.executable, "-c", WORKER, str(Path(__file__).with_name("echo_job.py"))]
        return subprocess.Popen(command, env=settings.environment(), stderr=log)

    def until_working(self, name, attempt=1):
        until(lambda: len(self.starts(name)) == attempt)
        until(lambda: self.queue.status(name).stage == "working")
        return self.starts(name)[-1]

    def close(self):
        if self.worker is not None:
            self.worker.terminate()
            self.worker.wait(250)
        super().close()


@pytest.fixture(scope="session")
def make_bench():
    """Makes a queue without a worker in a folder."""
    return Bench


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    bench = Bench(tmp_path_factory.mktemp("queue"))
    bench.start()
    yield bench
    bench.close()
