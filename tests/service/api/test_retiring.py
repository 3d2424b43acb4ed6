"""A scanner that is no more: a person retires it, and nobody waits for its answer; one that lives cannot be retired."""

import uuid

import httpx
import pytest
from sqlalchemy import select

from steradian.storage.db.tables import ScannerRow
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState
from support.apis import ApiProcess
from support.pairs import NOBODY, Pair
from support.waiting import until

from .conftest import EQUI

GONE = "/scanners/scanner-1"
_S = ScanState


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    pair = Pair(tmp_path_factory.mktemp("pair"))
    yield pair
    pair.close()


@pytest.fixture
def gone(pair):
    """A scanner whose node went, and of which the other nodes know; none after the test."""
    gone = pair.row.of("scanner-1")
    gone.ensure(simulated=True, address=NOBODY)
    gone.release_stop("test")
    until(lambda: "refused" in pair.http.delete(f"{GONE}/emergency-stop").text)
    yield gone
    pair.http.delete(GONE, params={"abandon": True})


def scanners(pair):
    return [each["id"] for each in pair.http.get("/scanners").json()["items"]]


def scan_of(pair, scanner_id, *states):
    """A scan of a scanner that has been through some states."""
    mask = pair.http.post("/masks", json=EQUI).json()
    plan = pair.http.post("/plans", json={"mask_id": mask["id"], "samples": 256}).json()
    wanted = {"plan_id": plan["id"], "scanner_id": scanner_id}
    scan = pair.http.post("/scans", json=wanted, headers={"Idempotency-Key": uuid.uuid4().hex})
    if scan.is_success:
        scans = ScanRepository(pair.scanner.database)
        for state in states:
            scans.transition(scan.json()["id"], state, why="test")
    return scan


def state_of(pair, scan):
    return pair.http.get(f"/scans/{scan.json()['id']}").json()["state"]


@pytest.mark.long
def test_a_scanner_without_a_node_is_retired_and_no_press_waits_for_it_any_more(pair, gone):
    pressed = pair.http.post(f"{GONE}/emergency-stop")
    assert pressed.json()["emergency_stop"]["laser"] == "unconfirmed"
    released = pair.http.delete(f"{GONE}/emergency-stop")
    assert (released.status_code, released.json()["code"]) == (503, "node-unavailable")
    retired = pair.http.delete(GONE)
    assert retired.status_code == 204, retired.text
    assert scanners(pair) == ["scanner-0"]
    assert pair.http.get(GONE).status_code == pair.http.delete(GONE).status_code == 404
    until(lambda: pair.http.post(f"{GONE}/emergency-stop").status_code == 404)
    assert scan_of(pair, "scanner-1").status_code == 404
    assert scan_of(pair, None).status_code == 201, "which scanner need not be said any more"
    pressed = pair.http.post("/emergency-stop").json()["items"]
    assert [one["id"] for one in pressed] == ["scanner-0"]
    pair.http.delete("/scanners/scanner-0/emergency-stop").raise_for_status()


def test_retire_scanner_with_responding_node_returns_409(pair):
    for url in (pair.other.url, pair.scanner.url):
        refused = pair.http.delete(f"{url}/api/v1/scanners/scanner-0")
        assert (refused.status_code, refused.json()["code"]) == (409, "in-use"), refused.text
    assert scanners(pair) == ["scanner-0"]


def test_a_node_that_another_scanner_has_at_the_address_by_now_is_not_taken_for_it(pair, gone):
    gone.ensure(simulated=True, address=pair.scanner.url)
    until(lambda: "another node's" in pair.http.delete(f"{GONE}/emergency-stop").text)
    assert pair.http.delete(GONE).status_code == 204


@pytest.mark.long
def test_retired_scanner_restart_restores_it_with_emergency_stop(tmp_path):
    pair = Pair(tmp_path)
    try:
        comes_back(pair)
    finally:
        pair.close()


def comes_back(pair):
    pair.scanner.close()
    pair.http.post("/scanners/scanner-0/emergency-stop", json={"reason": "smoke"})
    until(lambda: pair.row.get("scanner-0").stopped_at)
    assert pair.http.delete("/scanners/scanner-0").status_code == 204
    assert scanners(pair) == []
    pair.scanner = pair.start()
    assert scanners(pair) == ["scanner-0"]
    assert until(pair.latch.active).reason == "smoke"


def test_a_node_that_was_cut_off_while_its_scanner_was_retired_notes_it_again(pair):
    with pair.scanner.database.write() as session:
        row = session.scalars(select(ScannerRow).where(ScannerRow.id == "scanner-0")).one()
        row.retired = row.since
    until(lambda: scanners(pair) == ["scanner-0"])


@pytest.mark.parametrize(
    ("states", "then"),
    [
        ((), "aborted"),
        ((_S.ARMING, _S.RUNNING), "partial"),
        ((_S.ARMING, _S.RUNNING, _S.INTERRUPTED), "partial"),
        ((_S.ARMING, _S.FAILED), "failed"),
    ],
    ids=["queued", "running", "interrupted", "over"],
)
def test_retire_scanner_with_abandon_ends_its_unfinished_scan(pair, gone, states, then):
    scan = scan_of(pair, "scanner-1", *states)
    refused = pair.http.delete(GONE)
    if then == "failed":
        assert refused.status_code == 204
    else:
        assert (refused.status_code, refused.json()["code"]) == (409, "in-use")
        assert scan.json()["id"] in refused.json()["detail"]
        assert pair.http.delete(GONE, params={"abandon": True}).status_code == 204
    assert state_of(pair, scan) == then


@pytest.mark.long
def test_a_service_of_its_own_has_no_scanners_of_nodes_that_cannot_be(tmp_path):
    """`steradian serve` on the database of nodes: one of them may have left a scan."""
    former = Pair(tmp_path)
    former.row.of("scanner-1").ensure(simulated=True, address="http://192.0.2.1:8000")
    former.row.of("scanner-2").ensure(simulated=True)
    scan_of(former, "scanner-2", _S.ARMING, _S.RUNNING)
    former.close()
    alone = ApiProcess(tmp_path).wait()
    stop = f"{alone.url}/api/v1/scanners/scanner-2/emergency-stop"
    try:
        with httpx.Client(base_url=f"{alone.url}/api/v1", timeout=250) as http:
            assert {each["id"] for each in http.get("/scanners").json()["items"]} == {"scanner-0", "scanner-2"}
            pressed = until(lambda: (answer := http.post(stop)).is_success and answer.json()["emergency_stop"])
            assert pressed["laser"] == "unconfirmed"
            until(lambda: http.get("/scanners/scanner-2").json()["emergency_stop"])
            assert http.delete(stop).json()["emergency_stop"] is None
    finally:
        alone.close()
