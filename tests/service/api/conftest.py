import importlib.util
import os
import socket
import subprocess
import sys
import time
import uuid
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import httpx
import numpy as np
import pytest

from steradian.scans.store import AlineStore, create_scan_file
from steradian.settings import Settings
from steradian.storage.database import Database, metadata_url
from steradian.storage.paths import DataDirectory
from steradian.storage.plans import PlanRepository
from steradian.storage.scans import ScanRepository
from steradian.storage.states import ScanState

MAX_BODY, MAX_POINTS = 20_000, 5_000


class Server:
    """A real API process on a data directory, without acquisition and workers."""

    def __init__(self, folder, preexec_fn=None, **settings):
        limits = {"max_upload_bytes": MAX_BODY, "max_mask_points": MAX_POINTS, "max_volume_bytes": 2**24}
        self.settings = Settings.create(data=folder, **limits | settings)
        self.data = DataDirectory(folder)
        self.data.create()
        self.database = Database(metadata_url(self.settings))
        self.database.migrate()
        with socket.create_server(("127.0.0.1", 0)) as listener:
            self.url = f"http://127.0.0.1:{listener.getsockname()[1]}"
            self.process = subprocess.Popen(
                [sys.executable, "-m", "steradian.api", str(listener.fileno())],
                env=self.settings.environment(),
                stdin=subprocess.PIPE,
                stderr=subprocess.PIPE,
                pass_fds=[listener.fileno()],
                preexec_fn=preexec_fn,
            )

    def wait(self):
        deadline = time.monotonic() + 60
        while True:
            try:
                return httpx.get(f"{self.url}/healthz", timeout=10).raise_for_status()
            except httpx.HTTPError:
                assert time.monotonic() < deadline, "the API did not start"
                time.sleep(0.05)

    def until(self, condition):
        deadline = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < deadline, "it did not happen within 60 s"
            time.sleep(0.05)

    def close(self):
        self.process.stdin.close()
        try:
            self.process.wait(60)
        finally:
            self.process.kill()
            self.log = self.process.stderr.read().decode()
            self.process.stderr.close()
            self.database.close()


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    """An API on SQLite; on a PostgreSQL of its own where the environment says TEST_DATABASE=postgres."""
    with ExitStack() as stack:
        more = {}
        if os.environ.get("TEST_DATABASE") == "postgres":
            more["database_url"] = stack.enter_context(_postgres()).database()
        server = Server(tmp_path_factory.mktemp("api"), **more)
        server.wait()
        yield server
        server.close()


def _postgres():
    place = importlib.util.spec_from_file_location("postgres", Path(__file__).parents[1] / "postgres.py")
    module = importlib.util.module_from_spec(place)
    place.loader.exec_module(module)
    return module.running_postgres()


@pytest.fixture(scope="session")
def start_server():
    """Start an API process on a folder of its own; who starts it closes it."""
    return Server


@pytest.fixture(scope="session")
def http(server):
    with httpx.Client(base_url=f"{server.url}/api/v1", timeout=90) as client:
        yield client


def make_scan(http, plan_id, key=None):
    return http.post("/scans", json={"plan_id": plan_id}, headers={"Idempotency-Key": key or uuid.uuid4().hex})


EQUI = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 60}


@pytest.fixture
def mask(http):
    return http.post("/masks", json=EQUI).json()


@pytest.fixture
def plan(http, mask):
    return http.post("/plans", json={"mask_id": mask["id"], "samples": 256}).json()


@pytest.fixture
def scan(http, plan):
    return make_scan(http, plan["id"]).json()


@pytest.fixture
def scan_with_alines(server, http, plan):
    """A scan that ended partial with five of its A-lines in a real file, and a reconstruction of it in the queue."""
    made = make_scan(http, plan["id"]).json()
    scans = ScanRepository(server.database)
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.STOPPING, ScanState.PARTIAL):
        scans.transition(made["id"], state, why="test", summary={"points": 69, "stored": 5, "fired": 5})
    path, whole = server.data.scan_file(made["id"]), PlanRepository(server.database).load(plan["id"])
    create_scan_file(path, whole, scan_id=made["id"])
    with AlineStore(path) as store:
        store.append(Aline(point, np.full(whole.samples, point + 1, np.int16), shot=point + 1) for point in range(5))
        store.set_fired(5)
    job = http.post("/reconstructions", json={"scan_id": made["id"], "parameters": {"modes": 32}}).json()
    return {"scan": http.get(f"/scans/{made['id']}").json(), "reconstruction": job, "visit": whole.visit}


@dataclass
class Aline:
    """An A-line as a driver delivers it."""

    point: int
    samples: np.ndarray
    shot: int
    scale: float = 0.5
    energy: float = 1.0
    wavelength_m: float = 1.55e-6
    fire_time_s: float = 0.0
    averages: int = 1
    time_zero_offset_s: float = 0.0
    dc_v: float = 0.0
    gain_db: float = 0.0
    quality: int = 0
