"""A service on PostgreSQL and a worker of another host: one queue, priorities, and names that must differ."""

import subprocess
import sys
from pathlib import Path

import pytest

from steradian.storage.state_machines import ReconstructionState

pytestmark = [pytest.mark.crash, pytest.mark.timeout(180)]


def test_jobs_run_on_the_service_and_on_a_second_host(distributed):
    service = distributed
    service.start()
    service.start_worker(worker_name="other")
    names = [service.submit(f"job-{number}", "succeed", answer=number, seconds=1) for number in range(4)]
    service.until(lambda: (service.folder / "run" / "other-0.json").exists(), 40)
    names += [service.submit(f"late-{number}", "succeed", answer=number, seconds=1) for number in range(6)]
    service.until(lambda: all(service.queue.status(name).is_over for name in names), 60)
    jobs = [service.queue.status(name) for name in names]
    assert {job.state for job in jobs} == {ReconstructionState.SUCCEEDED}
    assert {job.attempts[-1]["worker"] for job in jobs} == {"worker-0", "other-0"}
    assert all(len(service.starts(name)) == 1 for name in names)

    # A second worker of one name is refused: the same name twice would run a job twice.
    command = [sys.executable, str(Path(__file__).with_name("worker_main.py")), "0"]
    settings = service.settings.model_copy(update={"worker_name": "other"})
    with (service.folder / "second.log").open("wb") as log:
        second = subprocess.Popen(command, env=settings.environment(), stdin=subprocess.PIPE, stderr=log)
        assert second.wait(250) != 0
        second.stdin.close()
    assert "another worker named other-0" in (service.folder / "second.log").read_text()
