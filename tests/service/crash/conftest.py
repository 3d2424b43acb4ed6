import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import httpx
import pytest

from steradian.jobs.engine import JobQueue
from steradian.jobs.model import JobRequest
from steradian.settings import Settings

HERE = Path(__file__).parent


def _load(name):
    spec = importlib.util.spec_from_file_location(name, HERE.parent / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Service:
    """The real service in processes of its own, its job queue's client, and a diary of every start of a job."""

    def __init__(self, folder, **settings):
        self.settings = Settings.create(data=folder, port=0, simulator_speed=20.0, **settings)
        self.folder, self.processes, self._queue = folder, [], None

    def start(self, kind="serve", **changes):
        settings = self.settings.model_copy(update=changes)
        log = (self.folder / "service.log").open("ab")
        command = [sys.executable, str(HERE / "service_main.py"), kind]
        process = subprocess.Popen(
            command, env=settings.environment(), stdout=log, stderr=log, stdin=subprocess.DEVNULL
        )
        log.close()
        self.processes.append(process)
        if kind == "serve":
            self.until(lambda: self.url is not None and self.answers, 60)
        return process

    @property
    def url(self):
        try:
            return json.loads((self.folder / "run" / "service.json").read_text())["url"]
        except (OSError, ValueError):
            return None

    @property
    def answers(self):
        try:
            return httpx.get(f"{self.url}/healthz", timeout=10).status_code == 200
        except httpx.HTTPError:
            return False

    @property
    def queue(self):
        if self._queue is None:
            self._queue = JobQueue(self.settings)
        return self._queue

    def submit(self, name, do, **more):
        payload = {"do": do, "diary": str(self.folder / name), **more}
        return self.queue.submit(JobRequest(name, "echo", payload))

    def starts(self, name):
        path = self.folder / name
        return [int(pid) for pid in path.read_text().split()] if path.exists() else []

    def pid_of(self, process):
        return json.loads((self.folder / "run" / f"{process}.json").read_text())["pid"]

    def until(self, condition, seconds):
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                log = (self.folder / "service.log").read_text()[-4000:]
                raise AssertionError(f"it did not happen within {seconds} s\n{log}")
            time.sleep(0.05)

    def kill(self, pid):
        os.kill(pid, signal.SIGKILL)

    def close(self):
        for process in self.processes:
            process.terminate()
        for process in self.processes:
            process.wait(60)
        if self._queue is not None:
            self._queue.close()


@pytest.fixture(params=["embedded", "postgres"])
def service(request, tmp_path):
    """A service with two workers, not started yet, in both modes."""
    more = {"database_url": request.getfixturevalue("postgres").database()} if request.param == "postgres" else {}
    service = Service(tmp_path, workers=2, **more)
    yield service
    service.close()


@pytest.fixture(scope="module")
def embedded(tmp_path_factory):
    """A running service with two workers and no database server."""
    service = Service(tmp_path_factory.mktemp("embedded"), workers=2)
    try:
        service.start()
        yield service
    finally:
        service.close()


@pytest.fixture(name="start_scan")
def _start_scan():
    """Asks for a scan of 53 points; returns its identifier."""
    return start_scan


def start_scan(url, pulse_rate=1):
    with httpx.Client(base_url=f"{url}/api/v1", timeout=90) as http:
        equi = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 60}
        mask = http.post("/masks", json=equi).json()
        plan = http.post("/plans", json={"mask_id": mask["id"], "samples": 256, "pulse_rate": pulse_rate}).json()
        key = {"Idempotency-Key": uuid.uuid4().hex}
        return http.post("/scans", json={"plan_id": plan["id"]}, headers=key).json()["id"]


@pytest.fixture
def distributed(postgres, tmp_path):
    """A service on PostgreSQL with one worker, not started yet."""
    service = Service(tmp_path, workers=1, database_url=postgres.database())
    yield service
    service.close()


@pytest.fixture
def load_proxy():
    """Makes a proxy in front of a PostgreSQL database."""
    return _load("crash/proxy").Proxy
