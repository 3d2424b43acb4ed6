import os
import signal
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from support import warmed
from support.echo import EchoQueue
from support.services import Service
from support.waiting import until

HERE = Path(__file__).parent


class Killed(Service, EchoQueue):
    """The real service, whose workers take jobs that do what they are told, and workers of other hosts."""

    command = (sys.executable, str(HERE / "service_main.py"), "serve")

    def __init__(self, folder, **settings):
        super().__init__(folder, simulator_speed=20.0, **settings)
        self.workers = []

    def start_worker(self, **changes):
        """Start ``steradian worker`` with other settings than the service's; returns its process."""
        command, settings = [*self.command[:-1], "worker"], self.settings.model_copy(update=changes)
        with self.log.open("ab") as log:
            worker = warmed.start(command, env=settings.environment(), stdout=log, stderr=log, stdin=subprocess.DEVNULL)
        self.workers.append(worker)
        return worker

    @property
    def answers(self):
        try:
            return httpx.get(f"{self.url}/healthz", timeout=10).status_code == 200
        except httpx.HTTPError:
            return False

    def until(self, condition, seconds):
        return until(condition, seconds, tell=lambda: self.log.read_text()[-4000:])

    def kill(self, pid):
        os.kill(pid, signal.SIGKILL)

    def close(self):
        for worker in self.workers:
            worker.terminate()
        Service.close(self)
        for worker in self.workers:
            worker.wait(250)
        EchoQueue.close(self)


@pytest.fixture(params=["embedded", "postgres"])
def service(request, tmp_path):
    """A service with two workers, not started yet, in both modes."""
    more = {"database_url": request.getfixturevalue("postgres").database()} if request.param == "postgres" else {}
    service = Killed(tmp_path, workers=2, **more)
    yield service
    service.close()


@pytest.fixture(scope="module", params=["embedded", "postgres"])
def running(request, tmp_path_factory):
    """A running service with two workers that loses processes one after another, in both modes."""
    more = {"database_url": request.getfixturevalue("postgres").database()} if request.param == "postgres" else {}
    service = Killed(tmp_path_factory.mktemp("running"), workers=2, **more)
    try:
        service.start()
        yield service
    finally:
        service.close()


@pytest.fixture(scope="module")
def embedded(tmp_path_factory):
    """A running service with two workers and no database server."""
    service = Killed(tmp_path_factory.mktemp("embedded"), workers=2)
    try:
        service.start()
        yield service
    finally:
        service.close()


@pytest.fixture
def distributed(postgres, tmp_path):
    """A service on PostgreSQL with one worker, not started yet."""
    service = Killed(tmp_path, workers=1, database_url=postgres.database())
    yield service
    service.close()
