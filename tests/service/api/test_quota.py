"""A quota of the data folder: what is in it and what jobs that wait will write count, and a refusal says so."""

import httpx
import pytest

from steradian.jobs.ledger import JobLedger
from steradian.jobs.model import Succeeded
from steradian.storage.scans import ScanRepository
from steradian.storage.states import ScanState

from .conftest import api_of, make_scan

MIB = 2**20
QUOTA = 40 * MIB
VOLUME = 4 * 128**2 * 256
"""Bytes of the values of a volume; 16 MiB."""


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A service whose folder may hold 40 MiB, a client of it and a scan."""
    server = api_of(tmp_path_factory.mktemp("quota"), quota_bytes=QUOTA, disk_reserve_bytes=0)
    server.wait()
    with httpx.Client(base_url=f"{server.url}/api/v1", timeout=90) as http:
        grid = {"arrangement": "grid", "aperture": 0.01, "count": 3, "interval": 1e-3}
        mask = http.post("/masks", json=grid).json()["id"]
        plan = http.post("/plans", json={"mask_id": mask, "samples": 256}).json()["id"]
        scan, scans = make_scan(http, plan).json()["id"], ScanRepository(server.database)
        for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.COMPLETING, ScanState.COMPLETE):
            scans.transition(scan, state, why="test", summary={"points": 9, "stored": 9, "fired": 9})
        server.data.scan_file(scan).write_bytes(b"not read here")
        yield server, http, {"scan_id": scan, "parameters": {"modes": 128}}
    server.close()


def refused(answer, needed):
    told = answer.json()
    assert (answer.status_code, told["code"]) == (507, "disk-full"), answer.text
    assert needed <= told["needed_bytes"] < 1.1 * needed
    assert told["available_bytes"] < told["needed_bytes"]
    assert "of the quota (quota_bytes), 41.9 MB, " in told["detail"]
    return told["promised_bytes"]


def test_what_waits_has_its_place_until_it_is_over_and_what_it_left_counts_then(small):
    server, http, volume = small
    for number in range(2):
        answer = http.post("/reconstructions", json=volume)
        assert answer.status_code == 202, (number, answer.text)
    first = answer.json()["id"]
    assert 2 * VOLUME < refused(http.post("/reconstructions", json=volume), VOLUME) < 2.1 * VOLUME
    assert 2 * VOLUME < refused(http.post("/batches", json=volume | {"vary": {"sound_speed": [1480]}}), VOLUME)
    assert 2 * VOLUME < refused(http.post("/uploads", content=bytes(10 * MIB)), 10 * MIB)
    answer = http.post("/uploads", content=(bytes(MIB) for _ in range(10)))  # of a length that is not stated
    assert (answer.status_code, answer.json()["promised_bytes"] > 2 * VOLUME) == (507, True), answer.text
    assert list(server.data.uploads.iterdir()) == []
    assert len(http.get("/jobs").json()["items"]) == 2

    ledger = JobLedger(server.database)
    fence = ledger.start(first, "test").fence
    server.data.job(first).root.mkdir()
    server.data.job(first).volume.write_bytes(bytes(VOLUME // 2))  # of what was promised
    assert VOLUME < refused(http.post("/reconstructions", json=volume), VOLUME) < 1.6 * VOLUME
    ledger.settle(first, fence, Succeeded({}), "test")
    assert http.post("/uploads", content=bytes(5 * MIB)).status_code == 201
    assert VOLUME < refused(http.post("/reconstructions", json=volume), VOLUME) < 1.1 * VOLUME
    assert http.delete(f"/jobs/{first}").status_code == 204
    assert http.post("/reconstructions", json=volume).status_code == 202


def test_without_a_quota_the_disk_is_the_limit(http, server):
    assert http.get("/").json()["limits"]["disk_available_bytes"] > 0
    assert server.settings.quota_bytes is None
