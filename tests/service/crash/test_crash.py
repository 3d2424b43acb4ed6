"""What is killed, and what becomes of the jobs: real processes, real signals, both databases where that may matter."""

import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import h5py
import httpx
import pytest

from steradian.storage.repositories.event_log import EventLog
from steradian.storage.state_machines import ReconstructionState, is_terminal

pytestmark = [pytest.mark.crash, pytest.mark.timeout(180)]
R = ReconstructionState
LIMIT = 30.0
embedded_only = pytest.mark.parametrize("running", ["embedded"], indirect=True)
JOBS = 8


def load(service, lot="job", seconds=0.5):
    """Queue ordinary jobs and one that kills its own process; return their names, which begin with the lot's."""
    names = [service.submit(f"{lot}-{number}", "succeed", answer=number, seconds=seconds) for number in range(JOBS)]
    names.insert(2, service.submit(f"{lot}-poison", "die"))
    service.until(lambda: service.starts(names[0]), 40)
    return names


def settle(service, names, killed, title, capsys):
    """Wait until all are over; check that each ended exactly once and print the counts."""
    service.until(lambda: all(service.queue.status(name).is_over for name in names), LIMIT)
    took = time.monotonic() - killed
    jobs = {name: service.queue.status(name) for name in names}
    for name, job in jobs.items():
        ends = [entry["state"] for entry in job.history if is_terminal(R(entry["state"]))]
        assert ends == [job.state], f"{name} ended {ends}"
        assert job.state is (R.FAILED if name.endswith("poison") else R.SUCCEEDED), (name, job.error)
    log = EventLog(service.queue.ledger.database)
    ours = [event for event in log.after(0, 10_000) if event.kind == "job" and event.resource_id in jobs]
    events = Counter(event.resource_id for event in ours if is_terminal(R(event.data["state"])))
    assert events == Counter(names), "one event for each end"
    poison = names[2]
    assert (jobs[poison].attempt, len(service.starts(poison))) == (3, 3)
    assert "SIGKILL" in (service.folder / "jobs" / poison / "log.txt").read_text()
    states, starts = Counter(str(job.state) for job in jobs.values()), sum(len(service.starts(n)) for n in names)
    mode = "postgres" if service.settings.database_url else "embedded"
    with capsys.disabled():
        counts = ", ".join(f"{count} {state}" for state, count in sorted(states.items()))
        print(f"\n  {mode:9} {title:28} {counts}; {starts} starts; all over {took:.1f} s after the kill")
    assert took < LIMIT


def test_a_killed_worker(running, capsys):
    names = load(running, "worker")
    killed = time.monotonic()
    running.kill(running.pid_of("worker-0"))
    settle(running, names, killed, "worker, kill -9", capsys)


@embedded_only
def test_a_killed_child(running, capsys):
    names = load(running, "child", seconds=1.0)
    killed = time.monotonic()
    running.kill(running.starts(names[0])[-1])
    settle(running, names, killed, "job's child, kill -9", capsys)
    assert running.queue.status(names[0]).attempts[0]["outcome"] in {"died", "succeeded"}


@pytest.mark.parametrize("running", ["postgres"], indirect=True)
def test_a_killed_api(running, capsys):
    names = load(running, "api")
    killed = time.monotonic()
    running.kill(running.pid_of("api"))
    settle(running, names, killed, "API, kill -9", capsys)
    running.until(lambda: running.answers, 20)


@embedded_only
def test_two_services_on_one_data_directory(running, capsys):
    names = load(running, "second")
    killed = time.monotonic()
    command = [sys.executable, str(Path(__file__).with_name("service_main.py")), "serve"]
    second = subprocess.run(command, env=running.settings.environment(), capture_output=True, text=True, timeout=30)
    assert second.returncode != 0
    assert "in use by process" in second.stderr
    settle(running, names, killed, "second service: refused", capsys)


def test_a_killed_supervisor_and_a_scan_that_ran(service, capsys):
    """Every process goes with it; after the next start jobs go on, and the scan waits for a person."""
    first = service.start().process
    scan_id = service.start_scan(service.plan(1600, pulse_rate=1, averages=2))["id"]
    service.until(lambda: read_scan(service.url, scan_id)["state"] == "running", 30)
    names = load(service)
    killed = time.monotonic()
    first.kill()
    first.wait()
    service.start()
    assert read_scan(service.url, scan_id)["state"] == "interrupted"
    fired = shots(service, scan_id)
    settle(service, names, killed, "supervisor, kill -9", capsys)
    assert read_scan(service.url, scan_id)["state"] == "interrupted", "it never fires by itself"
    assert shots(service, scan_id) == fired


def test_a_restart_with_queued_and_running_jobs(service, capsys):
    first = service.start().process
    names = load(service)
    killed = time.monotonic()
    first.send_signal(signal.SIGTERM)
    assert first.wait(10) == 0, "it ends within ten seconds"
    ended = time.monotonic() - killed
    assert all(not service.queue.status(name).state == R.RUNNING for name in names), "running jobs are put back"
    service.start()
    settle(service, names, killed, f"SIGTERM ({ended:.1f} s), restart", capsys)


def test_a_killed_database(distributed, postgres, capsys):
    """PostgreSQL gone for three seconds: everybody waits, nothing is lost."""
    service = distributed
    service.start()
    names = load(service)
    killed = time.monotonic()
    postgres.kill()
    time.sleep(3)
    postgres.start()
    settle(service, names, killed, "PostgreSQL, kill -9, 3 s", capsys)


def test_a_killed_host(distributed, capsys):
    """Workers of another host that is gone at once: the others take their jobs over."""
    service = distributed
    service.start()
    other = service.start_worker(worker_name="other")
    service.until(lambda: (service.folder / "run" / "other-0.json").exists(), 30)
    names = load(service, seconds=1.0)
    service.until(lambda: "other-0" in workers_of(service, names), 30)
    killed = time.monotonic()
    other.kill()
    other.wait()
    service.kill(service.pid_of("other-0"))
    settle(service, names, killed, "host of a worker", capsys)


def workers_of(service, names):
    return {attempt["worker"] for name in names for attempt in service.queue.status(name).attempts}


def read_scan(url, scan_id):
    return httpx.get(f"{url}/api/v1/scans/{scan_id}", timeout=90).json()


def shots(service, scan_id):
    with h5py.File(service.folder / "scans" / f"{scan_id}.h5") as file:
        return int(file["fired"][()])
