"""A queue with a real worker process and real jobs; what a job does stands in ``echo_job.py``."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from steradian.jobs.engine import JobQueue
from steradian.jobs.model import JobRequest
from steradian.settings import Settings

WORKER = """
import sys
from steradian.settings import Settings
from steradian.jobs.engine import run_worker
run_worker(Settings.create(), 0, {"echo": [sys.executable, sys.argv[1]]})
"""


class Bench:
    """A queue, its worker, and a diary in which each start of a job notes its process."""

    def __init__(self, folder, **settings):
        self.settings, self.log = Settings.create(data=folder, **settings), folder / "worker.log"
        self.queue = JobQueue(self.settings)
        self.worker = None

    def start(self):
        with self.log.open("ab") as log:
            self.worker = self.start_worker(self.settings, log)

    @staticmethod
    def start_worker(settings, log=None):
        command = [sys.executable, "-c", WORKER, str(Path(__file__).with_name("echo_job.py"))]
        return subprocess.Popen(command, env=settings.environment(), stderr=log)

    def submit(self, name, do, **more):
        payload = {"do": do, "diary": str(self.settings.data / name), **more}
        return self.queue.submit(JobRequest(name, "echo", payload))

    def starts(self, name):
        path = self.settings.data / name
        return [int(pid) for pid in path.read_text().split()] if path.exists() else []

    def until_working(self, name, attempt=1):
        self.until(lambda: len(self.starts(name)) == attempt)
        self.until(lambda: self.queue.status(name).stage == "working")
        return self.starts(name)[-1]

    @staticmethod
    def until(condition, seconds=60.0):
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, "it did not happen in time"
            time.sleep(0.02)

    def close(self):
        self.worker.terminate()
        self.worker.wait(60)
        self.queue.close()


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
