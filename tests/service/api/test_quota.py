"""A quota of the data folder: what is in it and what jobs that wait will write count, and a refusal says so."""

import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import httpx
import pytest
from sqlalchemy import text

from steradian.api.app import create_app
from steradian.core.exceptions import DiskFull
from steradian.jobs.job import JobRequest, Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.storage.capacity import quota as disk
from steradian.storage.capacity.quota import UploadReservations, reserved_bytes
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState
from support.pairs import Pair

from .conftest import api_of, make_scan

MIB = 2**20
QUOTA = 44 * MIB
VOLUME = 4 * (128**2 * 256 + 64**2 * 128)
"""Bytes of the values of a volume and of their coarser copy; 18 MiB."""


@pytest.fixture(scope="module")
def small(database, tmp_path_factory):
    """A service whose folder may hold 44 MiB, a client of it and a scan."""
    server = api_of(tmp_path_factory.mktemp("quota"), quota_bytes=QUOTA, disk_reserve_bytes=0, **database())
    server.wait()
    with httpx.Client(base_url=f"{server.url}/api/v1", timeout=250) as http:
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
    assert "of the quota (quota_bytes), 46.1 MB, " in told["detail"]
    return told["promised_bytes"]


def test_quota_reserves_waiting_job_space_until_end_then_counts_usage(small):
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
    fence = ledger.start_attempt(first, "test").fence
    server.data.job(first).root.mkdir()
    server.data.job(first).volume.write_bytes(bytes(VOLUME // 2))  # of what was promised
    assert VOLUME < refused(http.post("/reconstructions", json=volume), VOLUME) < 1.6 * VOLUME
    ledger.finish_attempt(first, fence, Succeeded({}), "test")
    assert http.post("/uploads", content=bytes(5 * MIB)).status_code == 201
    assert VOLUME < refused(http.post("/reconstructions", json=volume), VOLUME) < 1.1 * VOLUME
    assert http.delete(f"/jobs/{first}").status_code == 204
    assert http.post("/reconstructions", json=volume).status_code == 202


def test_storage_reports_usage_per_kind_and_available_bytes(tmp_path):
    server = api_of(tmp_path, quota_bytes=QUOTA, disk_reserve_bytes=0)
    server.wait()
    try:
        with server.database.write() as session:
            JobLedger(server.database).add(session, JobRequest("j1", "sound-speed", {}, promised=5 * MIB))
        server.data.scan_file("s1").write_bytes(bytes(3 * MIB))
        with httpx.Client(base_url=f"{server.url}/api/v1", timeout=250) as http:
            http.post("/uploads", content=bytes(2 * MIB)).raise_for_status()
            told = http.get("/storage").raise_for_status().json()
        used = told["used_bytes"]
        assert (used["scans"], used["uploads"], used["reconstructions"]) == (3 * MIB, 2 * MIB, 0)
        assert (told["quota_bytes"], told["reserve_bytes"], told["promised_bytes"]) == (QUOTA, 0, 5 * MIB)
        assert told["available_bytes"] == QUOTA - sum(used.values()) - 5 * MIB
        assert told["free_bytes"] > told["available_bytes"]
    finally:
        server.close()


def test_without_a_quota_the_disk_is_the_limit(http, server):
    assert http.get("/").json()["limits"]["disk_available_bytes"] > 0
    assert server.settings.quota_bytes is None


def test_uploads_that_come_at_once_do_not_take_the_same_room(tmp_path):
    """Four of 11 MiB, of lengths that are not stated, each begun before another has come: three fit, at most."""
    server, begun = api_of(tmp_path, quota_bytes=QUOTA, disk_reserve_bytes=0), threading.Barrier(4)
    server.wait()

    def pieces():
        yield bytes(1000)
        begun.wait(250)
        for _ in range(11):
            yield bytes(MIB)

    def send(_number):
        with httpx.Client(base_url=f"{server.url}/api/v1", timeout=250) as http:
            return http.post("/uploads", content=pieces()).status_code

    try:
        with ThreadPoolExecutor(4) as pool:
            answers = list(pool.map(send, range(4)))
        held = sum(path.stat().st_size for path in server.data.root.rglob("*") if path.is_file())
    finally:
        server.close()
    assert sorted(set(answers)) == [201, 507]
    assert held < QUOTA


def test_stated_uploads_reserve_their_room():
    """The second is refused although nothing of the first has come."""
    arrivals, room = UploadReservations(), 10

    def require(count):
        if count > room - arrivals.came - arrivals.awaited:
            raise DiskFull("full", needed=count, available=0, promised=0)

    with arrivals.upload(6, require) as take:
        with pytest.raises(DiskFull), arrivals.upload(5, require):
            pass
        take(4)
        with arrivals.upload(0, require) as other:
            other(4)
            with pytest.raises(DiskFull):
                other(1)
        take(2)
    assert (arrivals.came, arrivals.awaited) == (10, 0)

    def give_up():
        with arrivals.upload(0, lambda _count: None) as take:
            take(3)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        give_up()
    assert (arrivals.came, arrivals.awaited) == (10, 0), "what was given up holds no room"


def test_an_import_under_way_counts_once(tmp_path):
    """What it has written of its scan, beside the other scans, is no more promised."""
    server = api_of(tmp_path)
    ledger = JobLedger(server.database)
    try:
        with server.database.write() as session:
            ledger.add(session, JobRequest("j1", "import", {}, promised=5 * MIB))
        server.data.scan_file("s1").with_name("s1.h5.importing").write_bytes(bytes(3 * MIB))
        for started, left in ((False, 5), (True, 2)):
            if started:
                ledger.start_attempt("j1", "test")
            with server.database.read() as session:
                assert reserved_bytes(session, server.data) == left * MIB
    finally:
        server.close()


def test_quota_api_only_node_reserves_no_space_for_jobs(tmp_path):
    """An API node: what a thousand volumes will take is taken on the workers' disks."""
    pair = Pair(tmp_path)
    try:
        with pair.database.write() as session:
            JobLedger(pair.database).add(session, JobRequest("j1", "sound-speed", {}, promised=10**15))
        assert pair.http.post("/uploads", content=b"x" * 1000).status_code == 201
        told = pair.http.get("/storage").json()
        assert (told["promised_bytes"], told["available_bytes"] > 0) == (0, True)
        whole = httpx.post(f"{pair.scanner.url}/api/v1/uploads", content=b"x" * 1000, timeout=60)
        assert (whole.status_code, whole.json()["code"]) == (507, "disk-full"), "where jobs are done there is none"
    finally:
        pair.close()


def test_quota_counts_promise_of_job_writing_after_measurement(tmp_path):
    """It is not in what was measured, and would be in nothing."""
    server = api_of(tmp_path, quota_bytes=QUOTA, disk_reserve_bytes=0)
    services = create_app(server.settings).state.services
    ledger = JobLedger(server.database)
    try:
        with server.database.write() as session:
            ledger.add(session, JobRequest("j1", "reconstruct", {}, promised=30 * MIB))
        ledger.start_attempt("j1", "test")
        measured = services.refresh_disk_usage()
        folder = server.data.job("j1").root
        folder.mkdir(parents=True)
        (folder / "volume.h5").write_bytes(bytes(30 * MIB))
        for looked_at in (measured, services.refresh_disk_usage()):
            with services.database.write() as session, pytest.raises(DiskFull):
                services.require_disk_space(session, 30 * MIB, "the volume", looked_at)
            with services.database.write() as session:
                services.require_disk_space(session, 5 * MIB, "the volume", looked_at)
    finally:
        services.database.close()
        server.close()


@pytest.mark.parametrize(("role", "is_refused"), [("api", False), ("acquisition", True)])
def test_a_scan_needs_room_where_its_scanner_is_and_on_no_other_node(tmp_path, role, is_refused):
    server = api_of(tmp_path, quota_bytes=QUOTA, disk_reserve_bytes=0)
    services = create_app(server.settings.model_copy(update={"role": role})).state.services
    expected = pytest.raises(DiskFull) if is_refused else nullcontext()
    try:
        measured = services.refresh_disk_usage()
        with services.database.write() as session, expected:
            services.require_disk_space(session, 2 * QUOTA, "the scan", measured, for_scan=True)
    finally:
        services.database.close()
        server.close()


def test_the_folder_is_measured_while_others_write(small, monkeypatch):
    """On SQLite a transaction keeps every other writer waiting, so no walk through the folder belongs into it."""
    server, _, _ = small
    services = create_app(server.settings).state.services
    plain, walks = disk.size_of, []

    def walk(folder):
        with services.database.write() as session:
            session.execute(text("SELECT 1"))
        walks.append(folder)
        return plain(folder)

    monkeypatch.setattr(disk, "size_of", walk)
    measured = services.refresh_disk_usage()
    with services.database.write() as session:
        services.require_disk_space(session, 1, "the volume", measured)
    assert services.available < QUOTA
    assert walks == [server.data.root], "once, and not by who only wants to know how much is free"
    services.database.close()


def test_a_scan_that_does_not_fit_is_refused_and_one_that_waits_has_its_room(database, tmp_path):
    server = api_of(tmp_path, quota_bytes=QUOTA, disk_reserve_bytes=0, **database())
    server.wait()
    try:
        with httpx.Client(base_url=f"{server.url}/api/v1", timeout=250) as http:
            mask = http.post(
                "/masks", json={"arrangement": "grid", "aperture": 0.01, "count": 30, "interval": 1e-4}
            ).json()
            plans = [
                http.post("/plans", json={"mask_id": mask["id"], "samples": 2048, "frames": frames}).json()
                for frames in (5, 13)
            ]
            small, large = (plan["preview"]["bytes"] for plan in plans)
            assert small < QUOTA / 2 < QUOTA < large
            refused(make_scan(http, plans[1]["id"]), large)
            first = make_scan(http, plans[0]["id"])
            assert first.status_code == 201
            assert make_scan(http, plans[0]["id"]).status_code == 201
            assert refused(make_scan(http, plans[0]["id"]), small) >= 2 * small
            assert refused(http.post("/uploads", content=bytes(10 * MIB)), 10 * MIB) >= 2 * small
            aborted = http.put(f"/scans/{first.json()['id']}/desired-state", json={"state": "aborted"})
            assert aborted.status_code == 200
            ScanRepository(server.database).transition(first.json()["id"], ScanState.ABORTED, why="test")
            assert make_scan(http, plans[0]["id"]).status_code == 201, "the room of one that is over is free again"
    finally:
        server.close()
