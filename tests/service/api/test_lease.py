"""The scanner's lease belongs to whoever took it, and what fires needs it; what stops the laser never does."""

import uuid
from contextlib import ExitStack

import httpx
import pytest

from steradian.security.keys import KeyStore, Scope
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import DesiredScanState, ScanState

from .conftest import EQUI, api_of

LEASE, STOP = "/scanners/scanner-0/lease", "/scanners/scanner-0/emergency-stop"


class Operator:
    """A person with a key of their own."""

    def __init__(self, server, name, *scopes):
        key = KeyStore(server.database).create(name, scopes or [Scope.OPERATE, Scope.READ])
        self.http = server.stack.enter_context(client(server, key))

    def take(self, holder, fence=None):
        headers = {} if fence is None else {"Scanner-Lease": str(fence)}
        return self.http.put(LEASE, json={"holder": holder, "seconds": 600}, headers=headers)

    def fire(self, plan_id, fence=None):
        headers = {"Idempotency-Key": uuid.uuid4().hex} | ({} if fence is None else {"Scanner-Lease": str(fence)})
        return self.http.post("/scans", json={"plan_id": plan_id}, headers=headers)

    def wish(self, scan_id, state, fence=None):
        headers = {} if fence is None else {"Scanner-Lease": str(fence)}
        return self.http.put(f"/scans/{scan_id}/desired-state", json={"state": state}, headers=headers)

    def give_back(self, fence):
        return self.http.delete(LEASE, headers={"Scanner-Lease": str(fence)})


def client(server, key):
    return httpx.Client(base_url=f"{server.url}/api/v1", headers={"Authorization": f"Bearer {key}"}, timeout=250)


@pytest.fixture(scope="module")
def guarded(tmp_path_factory):
    server = api_of(tmp_path_factory.mktemp("guarded"), require_key=True, api_key="k" * 24)
    with ExitStack() as server.stack:
        server.wait()
        yield server
    server.close()


@pytest.fixture(scope="module")
def plan(guarded):
    with client(guarded, "k" * 24) as admin:
        mask = admin.post("/masks", json=EQUI).json()
        return admin.post("/plans", json={"mask_id": mask["id"], "samples": 256}).json()["id"]


@pytest.fixture(scope="module")
def people(guarded):
    return Operator(guarded, "Ada"), Operator(guarded, "Ben")


@pytest.fixture(autouse=True)
def free(guarded):
    """Nobody holds the scanner, and nobody stopped it."""
    yield
    scanner = ScannerRepository(guarded.database)
    row = scanner.get("scanner-0")
    if scanner.is_held(row):
        scanner.release(row.fence, row.held_by)


def paused(guarded, scan_id):
    scans = ScanRepository(guarded.database)
    scans.transition(scan_id, ScanState.ARMING, why="test")
    scans.transition(scan_id, ScanState.RUNNING, why="test")
    scans.set_desired_state(scan_id, DesiredScanState.PAUSED, "coffee")
    scans.transition(scan_id, ScanState.PAUSING, why="test")
    scans.transition(scan_id, ScanState.PAUSED, why="test")


def test_lease_request_with_holder_name_by_other_key_returns_409(people):
    ada, ben = people
    lease = ada.take("Ada").json()["lease"]
    assert lease["principal"].startswith("key Ada (")
    stolen = ben.take("Ada")
    assert (stolen.status_code, stolen.json()["code"]) == (409, "lease-held")
    assert ben.take("Ada", lease["fence"]).status_code == 409, "nor by its number, which everybody may read"
    assert ada.take("Ada").json()["lease"]["fence"] == lease["fence"], "the holder holds it for longer"


def test_a_lease_of_another_does_not_let_fire(people, plan):
    ada, ben = people
    fence = ada.take("Ada").json()["lease"]["fence"]
    seen = ben.http.get("/scanners/scanner-0").json()["lease"]["fence"]
    assert seen == fence
    refused = ben.fire(plan, seen)
    assert (refused.status_code, refused.json()["code"]) == (409, "lease-held")
    assert ada.fire(plan, fence).status_code == 201


def test_nor_is_it_given_back_by_another(people):
    ada, ben = people
    fence = ada.take("Ada").json()["lease"]["fence"]
    assert ben.give_back(fence).status_code == 409
    assert ada.give_back(fence).status_code == 204


def test_admin_can_release_lease_of_absent_holder(guarded, people):
    ada, _ = people
    fence = ada.take("Ada").json()["lease"]["fence"]
    admin = Operator(guarded, "admin", Scope.ADMIN)
    assert admin.give_back(fence - 1).status_code == 409, "a number that is over"
    assert admin.give_back(fence).status_code == 204


def test_lease_distinguishes_two_clients_of_same_key(people):
    ada, _ = people
    fence = ada.take("left screen").json()["lease"]["fence"]
    assert ada.take("right screen").status_code == 409
    assert ada.take("right screen", fence).json()["lease"]["fence"] == fence, "one that knows the number goes on"


def test_unpausing_fires_and_needs_the_lease(guarded, people, plan):
    ada, ben = people
    fence = ada.take("Ada").json()["lease"]["fence"]
    scan = ada.fire(plan, fence).json()["id"]
    paused(guarded, scan)
    for who, number in ((ben, None), (ben, fence), (ada, None), (ada, fence - 1)):
        refused = who.wish(scan, "running", number)
        assert (refused.status_code, refused.json()["code"]) == (409, "lease-held"), (who, number)
    assert ScanRepository(guarded.database).get(scan).desired_state == "paused"
    assert ada.wish(scan, "running", fence).json()["desired_state"] == "running"
    for state in ("paused", "stopped"):
        assert ben.wish(scan, state).status_code == 200, "whoever may operate may make the laser rest"


def test_resumed_scan_runs_under_lease_of_resuming_client(guarded, people, plan):
    ada, ben = people
    first = ada.take("Ada").json()["lease"]["fence"]
    scan = ada.fire(plan, first).json()["id"]
    paused(guarded, scan)
    ada.give_back(first)
    second = ben.take("Ben").json()["lease"]["fence"]
    assert ben.wish(scan, "running", second).json()["fence"] == second
    scans = ScanRepository(guarded.database)
    assert ScannerRepository(guarded.database).refusal_reason(scans.get(scan)) is None, "acquisition sees it so, too"


def test_the_emergency_stop_needs_no_lease_and_nothing_fires_after_it(guarded, people, plan):
    ada, ben = people
    fence = ada.take("Ada").json()["lease"]["fence"]
    scan = ada.fire(plan, fence).json()["id"]
    paused(guarded, scan)
    reader = Operator(guarded, "reader", Scope.READ)
    assert reader.http.post(STOP).status_code == 202
    try:
        assert ada.wish(scan, "running", fence).status_code == 409
        refused = ada.fire(plan, fence)
        assert (refused.status_code, refused.json()["code"]) == (409, "emergency-stopped")
    finally:
        assert ben.http.delete(STOP).status_code == 200, "an operator releases it, lease or not"
