"""A job is done by a worker that has what it requires; others pass it over."""

import subprocess
import sys
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from steradian.core.exceptions import InvalidInput
from steradian.core.settings import Settings
from steradian.core.system_resources import total_memory
from steradian.jobs.job import JobRequest, Requirements
from steradian.jobs.queue.estimates import backlog, forecast
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.jobs.queue.matching import (
    Capabilities,
    WorkerRegistration,
    count_unsatisfiable,
    missing_capability,
    present_workers,
    require_satisfiable,
)
from steradian.jobs.registry import LIVE_KIND
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.state_machines import ReconstructionState
from support.waiting import until

GIB = 2**30
NOW = datetime(2026, 1, 1, tzinfo=UTC)
WORKER = """
import sys
from steradian.core.settings import Settings
from steradian.jobs.queue.matching import Capabilities
from steradian.jobs.worker.main import run_worker
_, slot, memory, cores, gpu, job = sys.argv
has = Capabilities(int(memory), int(cores), gpu or None)
run_worker(Settings.create(), int(slot), {"echo": [sys.executable, job]}, has)
"""


class Workers:
    """Worker processes on one queue, each with what it is told to have."""

    def __init__(self, bench):
        self.bench, self.processes = bench, []

    def start(self, memory, cores=1, gpu=""):
        job = str(Path(__file__).with_name("echo_job.py"))
        words = [str(len(self.processes)), str(memory), str(cores), gpu, job]
        command = [sys.executable, "-c", WORKER, *words]
        self.processes.append(subprocess.Popen(command, env=self.bench.settings.environment()))

    def submit(self, name, **requires):
        payload = {"do": "succeed", "answer": 1, "diary": str(self.bench.settings.data / name)}
        return self.bench.queue.submit(JobRequest(name, "echo", payload, requires=Requirements(**requires)))

    def done_by(self, name):
        until(lambda: self.bench.queue.status(name).is_over)
        job = self.bench.queue.status(name)
        assert job.state is ReconstructionState.SUCCEEDED, job.error
        return job.attempts[-1]["worker"]

    def close(self):
        for process in self.processes:
            process.terminate()
        for process in self.processes:
            process.wait(250)
        self.bench.close()


@pytest.fixture(params=["embedded", "postgres"])
def crew(request, tmp_path, make_bench):
    url = request.getfixturevalue("postgres").database() if request.param == "postgres" else None
    crew = Workers(make_bench(tmp_path, database_url=url, workers=3))
    yield crew
    crew.close()


@pytest.mark.long
def test_job_waits_for_capable_worker_without_blocking_later_jobs(crew):
    crew.submit("large", memory=4 * GIB)
    crew.submit("wide", cores=8)
    crew.submit("on-gpu", gpu=True)
    crew.submit("small", memory=GIB, cores=1)
    crew.start(memory=2 * GIB)
    assert crew.done_by("small") == "worker-0"
    crew.submit("another")
    assert crew.done_by("another") == "worker-0"
    waiting = ("large", "wide", "on-gpu")
    assert [crew.bench.queue.status(name).state for name in waiting] == [ReconstructionState.QUEUED] * 3
    assert not any(crew.bench.starts(name) for name in waiting)

    crew.start(memory=4 * GIB, cores=8)
    assert [crew.done_by(name) for name in ("large", "wide")] == ["worker-1"] * 2
    crew.start(memory=GIB, gpu="a card")
    assert crew.done_by("on-gpu") == "worker-2"
    assert len(crew.bench.starts("on-gpu")) == 1


@pytest.fixture
def ledger(tmp_path):
    """A ledger without an engine, at a time of its own."""
    settings = Settings.create(data=tmp_path)
    DataDirectory(settings.data).create()
    with closing(Database(metadata_url(settings))) as database:
        database.migrate()
        yield JobLedger(database, lambda: NOW)


def note(ledger, name, *has, ago=timedelta()):
    WorkerRegistration(ledger.database, name, Capabilities(*has), lambda: NOW - ago).publish()


@pytest.mark.parametrize(
    ("wanted", "field"),
    [
        (Requirements(memory=GIB, cores=4), None),
        (Requirements(memory=8 * GIB, cores=1), None),
        (Requirements(gpu=True), None),
        (Requirements(memory=9 * GIB), "requires.memory"),
        (Requirements(cores=5), "requires.cores"),
        (Requirements(memory=8 * GIB, cores=4), "requires"),  # each of the two has a worker, not both at once
        (Requirements(cores=2, gpu=True), "requires"),
    ],
)
def test_unsatisfiable_requirements_are_refused_with_capabilities(ledger, wanted, field):
    note(ledger, "many-0", 2 * GIB, 4)
    note(ledger, "large-0", 8 * GIB, 1, "a card")
    with ledger.database.read() as session:
        if field is None:
            return require_satisfiable(session, NOW, None, wanted)
        with pytest.raises(InvalidInput) as refused:
            require_satisfiable(session, NOW, None, wanted)
    assert refused.value.field == field
    for has in ("2147483648 bytes of memory, 4 cores, no GPU", "8589934592 bytes of memory, 1 core, a card"):
        assert has in str(refused.value)
    return None


def test_a_gpu_that_no_worker_has_is_refused_by_the_parameter_that_asks_for_it(ledger):
    note(ledger, "worker-0", None, 4)
    with (
        ledger.database.read() as session,
        pytest.raises(InvalidInput, match=r"parameters\.device.*gpu.*memory of unknown size, 4 cores, no GPU"),
    ):
        require_satisfiable(session, NOW, None, Requirements(gpu=True))


def test_where_no_worker_was_here_lately_nothing_is_refused(ledger):
    with ledger.database.read() as session:
        require_satisfiable(session, NOW, None, Requirements(memory=2**49, gpu=True))
    note(ledger, "worker-0", GIB, 1, ago=timedelta(hours=2))
    with ledger.database.read() as session:
        require_satisfiable(session, NOW, None, Requirements(memory=2**49, gpu=True))
        assert present_workers(session, NOW) == {}


def test_unsatisfiable_waiting_job_reports_missing_capability(ledger):
    wanted = Requirements(memory=4 * GIB, gpu=True)
    with ledger.database.write() as session:
        ledger.add(session, JobRequest("j1", "echo", {}, requires=wanted))
        ledger.add(session, JobRequest("j2", "echo", {}))
    note(ledger, "small-0", GIB, 2)
    note(ledger, "large-0", 8 * GIB, 2, "a card")
    assert ledger.status("j1").requires == wanted
    with ledger.database.read() as session:
        present = present_workers(session, NOW)
        assert set(present) == {"small-0", "large-0"}
        assert missing_capability(None, wanted, present) is None
        assert count_unsatisfiable(session, present) == 0

    note(ledger, "large-0", 8 * GIB, 2, "a card", ago=timedelta(minutes=5))
    with ledger.database.read() as session:
        present = present_workers(session, NOW)
        said = missing_capability(None, wanted, present)
        assert said == (
            "a worker with 4294967296 bytes of memory and a GPU; present: 1073741824 bytes of memory, 2 cores, no GPU"
        )
        assert count_unsatisfiable(session, present) == 1
        assert missing_capability(None, Requirements(), present) is None
        first, second = (forecast(session, job, 2, NOW) for job in ("j1", "j2"))
    assert (first.position, first.awaited) == (None, said)
    assert second.position == 1, "what nobody here can do holds up nobody"
    with ledger.database.read() as session:
        assert backlog(session, NOW + timedelta(seconds=7), present).oldest == 7


def test_scanner_worker_counts_only_for_live_jobs_of_its_scanner(ledger):
    note(ledger, "scanner-0-0", GIB, 2, "a card", "scanner-0")
    wanted = Requirements(memory=2 * GIB)
    with ledger.database.read() as session:
        present = present_workers(session, NOW)
        require_satisfiable(session, NOW, None, wanted)  # of those who would do it nothing is known
        assert missing_capability(None, wanted, present) is None
        with pytest.raises(InvalidInput, match=r"requires\.memory"):
            require_satisfiable(session, NOW, "scanner-0", wanted)
        assert missing_capability("scanner-0", wanted, present).startswith("a worker with 2147483648 bytes")
        require_satisfiable(session, NOW, "scanner-0", Requirements(gpu=True))


def test_a_worker_of_another_scanner_s_node_makes_no_image_of_this_one(ledger):
    note(ledger, "any-0", GIB, 2)
    note(ledger, "scanner-1-0", GIB, 2, "a card", "scanner-1")
    wanted = Requirements(gpu=True)
    with ledger.database.read() as session:
        present = present_workers(session, NOW)
        with pytest.raises(InvalidInput, match=r"parameters\.device"):
            require_satisfiable(session, NOW, "scanner-0", wanted)
        assert missing_capability("scanner-0", wanted, present).startswith(
            "a worker with a GPU; present: 1073741824 bytes"
        )
        assert missing_capability("scanner-1", wanted, present) is None


def test_backlog_counts_waiting_jobs_with_only_scanner_workers(ledger):
    note(ledger, "scanner-0-0", GIB, 2, None, "scanner-0")
    with ledger.database.write() as session:
        ledger.add(session, JobRequest("j1", "echo", {}, requires=Requirements(gpu=True)))
    with ledger.database.read() as session:
        assert backlog(session, NOW + timedelta(seconds=7), present_workers(session, NOW)).oldest == 7


def test_unsatisfiable_job_does_not_block_queue_position(ledger):
    note(ledger, "any-0", GIB, 2)
    note(ledger, "scanner-1-0", GIB, 2, "a card", "scanner-1")
    with ledger.database.write() as session:
        ledger.add(session, JobRequest("j1", "echo", {}, requires=Requirements(gpu=True)))
        ledger.add(session, JobRequest("j2", "echo", {}))
    with ledger.database.read() as session:
        assert forecast(session, "j2", 2, NOW).position == 1


def test_a_growing_image_that_no_worker_can_make_is_counted(ledger):
    note(ledger, "any-0", GIB, 2)
    with ledger.database.write() as session:
        ledger.add(session, JobRequest("j1", LIVE_KIND, {}, requires=Requirements(gpu=True)))
    with ledger.database.read() as session:
        assert count_unsatisfiable(session, present_workers(session, NOW)) == 1


@pytest.mark.parametrize("ahead", [timedelta(minutes=-30), timedelta(minutes=30)])
def test_worker_with_large_clock_skew_is_not_present(ledger, ahead):
    note(ledger, "worker-0", GIB, 1, ago=-ahead)
    with ledger.database.read() as session:
        assert present_workers(session, NOW) == {}


def test_worker_memory_defaults_to_machine_memory(tmp_path):
    told = Settings.create(data=tmp_path, worker_memory_bytes=3 * GIB)
    assert Capabilities.of_this_machine(told, "a card") == Capabilities(3 * GIB, told.threads_per_job, "a card")
    there = next(line for line in Path("/proc/meminfo").read_text().splitlines() if line.startswith("MemTotal:"))
    found = Capabilities.of_this_machine(Settings.create(data=tmp_path), None).memory
    assert found == total_memory()
    assert 0 < found <= 1024 * int(there.split()[1])
