import os
import uuid

import httpx
import numpy as np
import pytest

from steradian.scans.acquisition.clear_fault_executor import ClearFaultExecutor
from steradian.scans.acquisition.port_monitor import PortMonitor
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.storage.data_dir.fault_requests import ClearFaultRequest
from steradian.storage.data_dir.scanner_status import StatusBlock
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState
from support.alines import Aline
from support.apis import ApiProcess

MAX_BODY, MAX_POINTS = 20_000, 5_000
PLAIN = False
"""What a client verifies where there is no TLS: to read the machine's certificates takes longer than most requests."""


def api_of(folder, **settings):
    """An API that takes small things only, unless a test says otherwise; who starts one closes it."""
    limits = {"max_upload_bytes": MAX_BODY, "max_mask_points": MAX_POINTS, "max_volume_bytes": 2**24}
    return ApiProcess(folder, **limits | settings)


@pytest.fixture(scope="session")
def database(request):
    """Makes the setting that names an empty PostgreSQL where TEST_DATABASE=postgres; else none, which is SQLite."""
    distributed = os.environ.get("TEST_DATABASE") == "postgres"
    postgres = request.getfixturevalue("postgres") if distributed else None
    return lambda: {"database_url": postgres.database()} if postgres else {}


@pytest.fixture(scope="session")
def server(database, tmp_path_factory):
    """An API on SQLite, or on PostgreSQL."""
    server = api_of(tmp_path_factory.mktemp("api"), **database()).wait()
    _shared.append(server)
    yield server
    _shared.remove(server)
    server.close()


_shared = []
"""The server that all modules share, once a test has asked for it."""


def free_scanner(http):
    """Release the emergency stop and the lease of the one scanner."""
    http.delete("/scanners/scanner-0/emergency-stop")
    if lease := http.get("/scanners/scanner-0").json()["lease"]:
        http.delete("/scanners/scanner-0/lease", headers={"Scanner-Lease": str(lease["fence"])})


@pytest.fixture(scope="module", autouse=True)
def scanner_is_free_for_the_next_module():
    """Undo what generated requests did: the next module would be refused its scans."""
    yield
    for server in _shared:
        with httpx.Client(base_url=f"{server.url}/api/v1", verify=PLAIN, timeout=250) as client:
            free_scanner(client)


@pytest.fixture(scope="session")
def http(server):
    with httpx.Client(base_url=f"{server.url}/api/v1", timeout=250) as client:
        yield client


class NoScanner:
    """A port without a scanner."""

    def present(self):
        return None


@pytest.fixture(scope="module")
def fault_clerk(server):
    """What carries out requests to clear a fault in an acquisition process, which the API here has not."""
    folder = server.data.emergency
    watch = PortMonitor(NoScanner(), StatusBlock(folder), lambda status: None)
    with ClearFaultExecutor(ClearFaultRequest(folder), watch).working():
        yield


def make_scan(http, plan_id, key=None):
    return http.post("/scans", json={"plan_id": plan_id}, headers={"Idempotency-Key": key or uuid.uuid4().hex})


EQUI = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 60}


def make_plan(http, mask_id):
    return http.post("/plans", json={"mask_id": mask_id, "samples": 256}).json()


@pytest.fixture
def mask(http):
    return http.post("/masks", json=EQUI).json()


@pytest.fixture
def plan(http, mask):
    return make_plan(http, mask["id"])


@pytest.fixture
def scan(http, plan):
    return make_scan(http, plan["id"]).json()


def make_scan_with_alines(server, http, plan_id):
    """Make a scan that ended partial with five of its A-lines in a real file, and queue a reconstruction of it."""
    made = make_scan(http, plan_id).json()
    scans = ScanRepository(server.database)
    for state in (ScanState.ARMING, ScanState.RUNNING):
        scans.transition(made["id"], state, why="test")
    path, whole = server.data.scan_file(made["id"]), PlanRepository(server.database).load(plan_id)
    create_scan_file(path, whole, scan_id=made["id"])
    with ScanFileWriter(path) as store:
        store.append(Aline(point, np.full(whole.samples, point + 1, np.int16), point + 1, 0.5) for point in range(5))
        store.record_shot_count(5)
    for state in (ScanState.STOPPING, ScanState.PARTIAL):  # not before: what a scan that is over leaves half is swept
        scans.transition(made["id"], state, why="test", summary={"points": 69, "stored": 5, "fired": 5})
    job = http.post("/reconstructions", json={"scan_id": made["id"], "parameters": {"modes": 32}}).json()
    return {"scan": http.get(f"/scans/{made['id']}").json(), "reconstruction": job, "visit": whole.visit}


@pytest.fixture
def scan_with_alines(server, http, plan):
    return make_scan_with_alines(server, http, plan["id"])
