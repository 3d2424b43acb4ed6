import socket
import subprocess
import sys
import time

import httpx
import pytest

from steradian.settings import Settings
from steradian.storage.database import Database
from steradian.storage.paths import DataDirectory

MAX_BODY, MAX_POINTS = 20_000, 5_000


class Server:
    """A real API process on a data directory, without acquisition and workers."""

    def __init__(self, folder):
        self.settings = Settings.create(
            data=folder, max_upload_bytes=MAX_BODY, max_mask_points=MAX_POINTS, max_volume_bytes=2**24
        )
        self.data = DataDirectory(folder)
        self.data.create()
        self.database = Database(self.data.metadata_url)
        self.database.migrate()
        with socket.create_server(("127.0.0.1", 0)) as listener:
            self.url = f"http://127.0.0.1:{listener.getsockname()[1]}"
            self.process = subprocess.Popen(
                [sys.executable, "-m", "steradian.api", str(listener.fileno())],
                env=self.settings.environment(),
                stdin=subprocess.PIPE,
                stderr=subprocess.PIPE,
                pass_fds=[listener.fileno()],
            )

    def wait(self):
        deadline = time.monotonic() + 30
        while True:
            try:
                return httpx.get(f"{self.url}/healthz", timeout=1).raise_for_status()
            except httpx.HTTPError:
                assert time.monotonic() < deadline, "the API did not start"
                time.sleep(0.05)

    def close(self):
        self.process.stdin.close()
        try:
            self.process.wait(10)
        finally:
            self.process.kill()
            self.log = self.process.stderr.read().decode()
            self.process.stderr.close()
            self.database.close()


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    server = Server(tmp_path_factory.mktemp("api"))
    server.wait()
    yield server
    server.close()


@pytest.fixture(scope="session")
def http(server):
    with httpx.Client(base_url=f"{server.url}/api/v1", timeout=30) as client:
        yield client


EQUI = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 60}


@pytest.fixture
def mask(http):
    return http.post("/masks", json=EQUI).json()


@pytest.fixture
def plan(http, mask):
    return http.post("/plans", json={"mask_id": mask["id"], "samples": 256}).json()


@pytest.fixture
def scan(http, plan):
    return http.post("/scans", json={"plan_id": plan["id"]}).json()
