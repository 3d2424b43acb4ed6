"""A worker's memory stays level: what one job took serves the next, and is not kept beside it."""

import json
import signal
import subprocess
import sys
from itertools import count
from pathlib import Path

import pytest

from steradian.core.settings import Settings
from support.echo import EchoQueue
from support.waiting import until

WORKER = """
import ctypes, gc, json, os, re, signal, sys, weakref
from steradian.runtime import worker_entry

class Ring:
    def __init__(self):
        self.own = self

c, rings = ctypes.CDLL(None), []
c.fopen.restype = ctypes.c_void_p
c.malloc_info.argtypes, c.fclose.argtypes = [ctypes.c_int, ctypes.c_void_p], [ctypes.c_void_p]

def heaps():
    c.malloc_info(0, stream := c.fopen(sys.argv[2].encode(), b"w"))
    c.fclose(stream)
    with open(sys.argv[2]) as file:
        return len(re.findall("<heap ", file.read()))

def tell(*_):
    told = {"heaps": heaps(), "rings": sum(ring() is not None for ring in rings)}
    gc.collect()
    told["held"] = len(gc.get_objects()) + gc.get_freeze_count()
    rings.append(weakref.ref(ring := Ring()))
    gc.collect()  # it is old now, and garbage once this function has ended
    with open(sys.argv[2], "w") as file:
        json.dump(told, file)
    os.rename(sys.argv[2], sys.argv[3])

signal.signal(signal.SIGUSR1, tell)
worker_entry.JOB_TYPES, worker_entry.CHILD_COMMAND = ["echo"], [sys.executable, sys.argv[1]]
worker_entry.main(0)
"""
JOBS = Path(__file__).parents[1] / "jobs" / "echo_job.py"


class Watched(EchoQueue):
    """A queue, and a worker that tells on a signal what it holds, and then leaves a ring of garbage."""

    def __init__(self, folder):
        super().__init__(Settings.create(data=folder))
        assert self.queue is not None  # it makes the tables
        self.told, self.numbers = folder / "told.json", count()
        command = [sys.executable, "-c", WORKER, str(JOBS), str(folder / "draft"), str(self.told)]
        self.worker = subprocess.Popen(command, env=self.settings.environment(), stdin=subprocess.PIPE)

    def run(self, jobs):
        names = [self.submit(f"j{next(self.numbers)}", "succeed", answer=1) for _ in range(jobs)]
        until(lambda: self.queue.status(names[-1]).is_over)

    def look(self):
        self.told.unlink(missing_ok=True)
        self.worker.send_signal(signal.SIGUSR1)
        until(self.told.exists)
        return json.loads(self.told.read_text())

    def close(self):
        self.worker.terminate()
        self.worker.communicate(timeout=250)
        super().close()


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    if sys.platform != "linux":
        pytest.skip("it asks glibc how many heaps there are: run it on Linux")
    watched = Watched(tmp_path_factory.mktemp("watched"))
    yield watched
    watched.close()


@pytest.mark.long
def test_the_threads_of_a_worker_share_a_heap(watched):
    """With one for each, every one of them grew to the most that any job took there, for an hour and longer."""
    watched.run(20)
    assert watched.look()["heaps"] == 1


@pytest.mark.long
def test_garbage_waits_for_the_end_of_a_job_and_not_for_tens_of_thousands_of_objects(watched):
    """Rings of garbage that are old when they become it, as a long job leaves them."""
    watched.run(1)
    watched.look()
    watched.run(2)  # the second begins when the first is all over
    assert watched.look()["rings"] == 0


@pytest.mark.long
def test_worker_object_count_does_not_grow_with_jobs(watched):
    """What would be kept of each job is ten objects and more; what the queue's polls hold comes and goes."""
    watched.run(60)
    before = watched.look()["held"]
    watched.run(200)
    assert watched.look()["held"] - before < 5 * 200
