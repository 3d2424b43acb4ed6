"""A backup of a service that works, restored elsewhere: everything that was answered before is there and goes on."""

import hashlib
import sys

import h5py
import pytest

from steradian.scans.file.verify import verify_scan_file
from support import warmed
from support.services import Service
from support.waiting import until

pytestmark = [pytest.mark.crash, pytest.mark.timeout(400)]
JOBS = 10
NOUNS = ("masks", "plans", "scans", "batches", "reconstructions", "jobs")
STERADIAN = (sys.executable, "-m", "steradian")


@pytest.fixture(params=["embedded", "postgres"])
def databases(request):
    """Settings of the original and of the copy."""
    if request.param == "embedded":
        return {}, {}
    postgres = request.getfixturevalue("postgres")
    return {"database_url": postgres.database()}, {"database_url": postgres.database()}


def steradian(settings, *words):
    done = warmed.run([*STERADIAN, *map(str, words)], env=settings.environment())
    assert done.returncode == 0, done.stdout + done.stderr


def stored(file):
    with h5py.File(file) as opened:
        return {row for row, status in enumerate(opened["alines/status"][()]) if status}


def everything(service):
    """All lists of the service, each by the identifiers in it."""
    nouns = ("masks", "plans", "scans", "batches", "reconstructions", "jobs")
    return {
        noun: {one["id"] for one in service.get(f"/{noun}", params={"limit": 200}).json()["items"]} for noun in nouns
    }


def test_restored_backup_contains_all_acknowledged_data(databases, tmp_path):
    first, second = databases
    service = Service(tmp_path / "data", log=tmp_path / "first.log", workers=2, simulator_speed=20.0, **first).start()
    other = Service(tmp_path / "elsewhere", log=tmp_path / "second.log", workers=2, simulator_speed=500.0, **second)
    try:
        whole = service.make("/scans", plan_id=service.plan())
        assert whole["state"] == "complete"
        volume = service.done("/reconstructions", scan_id=whole["id"], parameters={"modes": 16})
        running = service.start_scan(service.plan(pulse_rate=1, averages=30))["id"]
        upload = service.http.post("/uploads", content=b"recorded" * 1000).json()["id"]
        jobs = [
            service.make("/reconstructions", scan_id=whole["id"], parameters={"modes": 64 + number})["id"]
            for number in range(JOBS)
        ]
        file = tmp_path / "data" / "scans" / f"{running}.h5"
        until(lambda: file.exists() and len(stored(file)) > 2)
        ways = f"/reconstructions/{volume['id']}/volume", f"/scans/{whole['id']}/file"
        kept = {way: hashlib.sha256(service.get(way).content).hexdigest() for way in ways}
        before, alines = everything(service), stored(file)
        steradian(service.settings, "backup", tmp_path / "backup", "--data", service.folder)
        assert service.get(f"/scans/{running}").json()["state"] == "running", "the scan went on meanwhile"
        service.close()

        steradian(other.settings, "check", tmp_path / "backup")
        steradian(other.settings, "restore", tmp_path / "backup", other.folder)
        steradian(other.settings, "check", other.folder)
        copied = other.folder / "scans" / f"{running}.h5"
        assert alines <= stored(copied)
        assert verify_scan_file(copied, repair=False).is_consistent
        other.start()
        after = everything(other)
        assert {noun: known - after[noun] for noun, known in before.items()} == {noun: set() for noun in before}
        assert other.get(f"/uploads/{upload}").json()["bytes"] == 8000
        assert {way: hashlib.sha256(other.get(way).content).hexdigest() for way in ways} == kept
        assert other.get(f"/scans/{running}").json()["state"] == "interrupted", "it never fires by itself"
        resumed = other.http.put(f"/scans/{running}/desired-state", json={"state": "running"})
        assert resumed.status_code in (200, 202), resumed.text
        for job in jobs:
            until(lambda job=job: other.get(f"/jobs/{job}").json()["state"] in {"succeeded", "failed"}, 300)
        assert {other.get(f"/jobs/{job}").json()["state"] for job in jobs} == {"succeeded"}
        until(lambda: other.get(f"/scans/{running}").json()["state"] == "complete", 300)
    finally:
        service.close()
        other.close()
