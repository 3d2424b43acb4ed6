"""A disk that is nearly full, and one that is full: a file system of its own, real requests."""

import contextlib
import socket

import httpx
import pytest

from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState
from support.disks import small_disk
from support.waiting import until

from .conftest import api_of, make_scan

pytestmark = pytest.mark.long

MIB = 2**20


@pytest.fixture
def small(tmp_path):
    with small_disk(tmp_path / "small") as folder:
        yield folder


@contextlib.contextmanager
def serving(folder, **settings):
    server = api_of(folder, **settings)
    try:
        server.wait()
        with httpx.Client(base_url=f"{server.url}/api/v1", timeout=250) as http:
            yield server, http
    finally:
        server.close()


def chunked(count):
    """A body whose length is not stated."""
    return (bytes(MIB) for _ in range(count))


def fill(path):
    with path.open("wb", buffering=0) as file:
        for piece in (MIB, 4096, 1):
            with contextlib.suppress(OSError):
                while True:
                    file.write(bytes(piece))


def test_an_upload_of_unknown_length_leaves_the_reserve_free(small):
    with serving(small / "data", disk_reserve_bytes=20 * MIB) as (server, http):
        kept = http.post("/uploads", content=chunked(10))
        assert (kept.status_code, kept.json()["bytes"]) == (201, 10 * MIB)
        answer = http.post("/uploads", content=chunked(60))
        assert (answer.status_code, answer.json()["code"]) == (507, "disk-full"), answer.text
        assert answer.json()["available_bytes"] < answer.json()["needed_bytes"] <= MIB
        assert [path.name for path in server.data.uploads.iterdir()] == [kept.json()["id"]]
        told = http.get("/storage").json()
        assert told["available_bytes"] == told["free_bytes"] - told["reserve_bytes"]
        assert abs(http.get("/").json()["limits"]["disk_available_bytes"] - told["available_bytes"]) < MIB
        assert told["used_bytes"]["uploads"] == 10 * MIB
        stated = http.post("/uploads", content=bytes(45 * MIB))
        assert (stated.status_code, stated.json()["needed_bytes"]) == (507, 45 * MIB)
        assert 0 < stated.json()["available_bytes"] < 40 * MIB
    assert "Traceback" not in server.log


def test_a_full_disk_is_a_507_wherever_it_is_met(small):
    grid = {"arrangement": "grid", "aperture": 0.01, "count": 3, "interval": 1e-3}
    with serving(small / "data", disk_reserve_bytes=0, max_mask_points=50_000) as (server, http):
        mask = http.post("/masks", json=grid).json()
        until(lambda: httpx.get(f"{server.url}/readyz", timeout=250).json()["checks"]["queue"])
        fill(small / "filler")
        answers = [
            http.get(mask["links"]["picture"].removeprefix("/api/v1")),
            *(http.post("/masks", json=grid | {"count": count, "interval": 1e-5}) for count in (100, 120, 140)),
            http.post("/uploads", content=bytes(MIB)),
            http.post("/uploads", content=chunked(1)),
        ]
        told = [(answer.status_code, answer.json()["code"]) for answer in answers]
        assert told == [(507, "disk-full")] * len(answers)
        assert http.get(mask["links"]["self"].removeprefix("/api/v1")).json() == mask
        (small / "filler").unlink()
        assert http.post("/masks", json=grid | {"count": 100, "interval": 1e-5}).status_code == 201
        assert list(server.data.uploads.iterdir()) == []
        assert not list(server.data.picture("x").parent.glob("*.new"))
    assert "Traceback" not in server.log


def test_a_client_that_leaves_in_the_middle_of_an_upload_leaves_nothing(tmp_path):
    with serving(tmp_path) as (server, http):
        head = f"POST /api/v1/uploads HTTP/1.1\r\nHost: localhost\r\nContent-Length: {MIB}\r\n\r\n".encode()
        with socket.create_connection(("127.0.0.1", http.base_url.port)) as line:
            line.sendall(head + b"x" * 1000)
            until(lambda: any(server.data.uploads.iterdir()))
        until(lambda: not any(server.data.uploads.iterdir()))
        assert http.get("/").status_code == 200
    assert "Traceback" not in server.log


def scan_of(server, http, samples):
    """A complete scan; its file is not read before a job runs."""
    mask = http.post("/masks", json={"arrangement": "grid", "aperture": 0.01, "count": 3, "interval": 1e-3}).json()
    plan = http.post("/plans", json={"mask_id": mask["id"], "samples": samples}).json()
    scan = make_scan(http, plan["id"]).json()["id"]
    scans = ScanRepository(server.database)
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.COMPLETING, ScanState.COMPLETE):
        scans.transition(scan, state, why="test", summary={"points": 9, "stored": 9, "fired": 9})
    server.data.scan_file(scan).write_bytes(b"not read here")
    return scan


def test_jobs_exceeding_disk_space_return_507_with_needed_bytes(small):
    more = {"disk_reserve_bytes": 20 * MIB, "max_volume_bytes": 2**27}
    with serving(small / "data", **more) as (server, http):
        scan, samples = scan_of(server, http, samples=512), 512
        volume = {"scan_id": scan, "parameters": {"modes": 128}}
        one = 4 * (128**2 * samples) * (1 + 1 / 8 + 1 / 64)  # with its coarser copies
        sweep = volume | {"vary": {"sound_speed": [1480, 1490, 1500]}}
        for path, body, count in (
            ("/batches", sweep, 3),
            ("/reconstructions", volume | {"follow": True}, 2),
            ("/reconstructions", volume | {"parameters": {"modes": 256}}, 4),
        ):
            answer = http.post(path, json=body)
            assert (answer.status_code, answer.json()["code"]) == (507, "disk-full"), answer.text
            assert count * one < answer.json()["needed_bytes"] < 1.1 * count * one
            assert one < answer.json()["available_bytes"] < 2 * one
        assert http.post("/reconstructions", json=volume).status_code == 202
        (small / "filler").write_bytes(bytes(int(answer.json()["available_bytes"] - one // 2)))
        answer = http.post("/reconstructions", json=volume)
        assert (answer.status_code, answer.json()["code"]) == (507, "disk-full"), "less than the reserve would be free"
        assert answer.json()["available_bytes"] < one < answer.json()["needed_bytes"]
        assert len(http.get("/jobs").json()["items"]) == 1
        assert http.get("/batches").json()["items"] == []


def test_scan_may_use_the_reserve_but_not_more_than_the_disk(small):
    """A scan under way is what the reserve is for."""
    mask = {"arrangement": "grid", "aperture": 0.01, "count": 30, "interval": 1e-4}
    with serving(small / "data", disk_reserve_bytes=2**40) as (_, http):
        mask_id = http.post("/masks", json=mask).json()["id"]
        plans = [
            http.post("/plans", json={"mask_id": mask_id, "samples": 2048, "frames": frames}).json()
            for frames in (5, 40)
        ]
        assert http.post("/uploads", content=b"x").json()["available_bytes"] == 0
        assert make_scan(http, plans[0]["id"]).status_code == 201
        answer = make_scan(http, plans[1]["id"])
        assert (answer.status_code, answer.json()["code"]) == (507, "disk-full"), answer.text
        assert plans[1]["preview"]["bytes"] <= answer.json()["needed_bytes"]
