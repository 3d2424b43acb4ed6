"""DELETE: what depends on a thing is named or goes too, running things stay, and a half-done one is finished."""

import os
import signal
import time
import uuid

import httpx
import pytest
from sqlalchemy import func, select

from steradian.jobs.job import JobRequest, Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.storage.blobs.interface import FolderBlobStore
from steradian.storage.db.tables import RemovalRow
from steradian.storage.repositories.deletion import remove_files
from steradian.storage.repositories.event_log import EventLog
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState
from support.waiting import until

from .conftest import api_of

GRID = {"arrangement": "grid", "aperture": 0.01, "interval": 1e-4}


class Bench:
    """A mask, a plan, a finished scan and two finished reconstructions, one of them exported, with their files."""

    def __init__(self, server, http, count):
        self.server, self.http = server, http
        self.mask = http.post("/masks", json=GRID | {"count": count}).json()["id"]
        self.plan = http.post("/plans", json={"mask_id": self.mask, "samples": 64}).json()["id"]
        self.scan = self.add_scan(ScanState.COMPLETE)
        self.first, self.second = self.add_job("r"), self.add_job("r")
        self.export = self.add_job("j", kind="export", about={"reconstruction_id": self.first})

    def add_scan(self, state=None):
        key = {"Idempotency-Key": uuid.uuid4().hex}
        scan = self.http.post("/scans", json={"plan_id": self.plan}, headers=key).json()["id"]
        if state is not None:
            scans = ScanRepository(self.server.database)
            for following in (ScanState.ARMING, ScanState.RUNNING, ScanState.COMPLETING, state):
                scans.transition(scan, following, why="test", summary={"points": 9, "stored": 9, "fired": 9})
            self.server.data.scan_file(scan).write_bytes(b"A-lines")
        return scan

    def add_job(self, prefix, kind="reconstruction", about=None, over=True):
        if kind == "reconstruction":
            body = {"scan_id": self.scan, "parameters": {"modes": 8}}
            job = self.http.post("/reconstructions", json=body).json()["id"]
        else:
            job = f"{prefix}{uuid.uuid4().hex[:26]}"
            with self.server.database.write() as session:
                JobLedger(self.server.database).add(session, JobRequest(job, kind, about))
        if over:
            self.finish(job)
        return job

    def finish(self, job):
        ledger = JobLedger(self.server.database)
        ledger.finish_attempt(job, ledger.start_attempt(job, "test").fence, Succeeded({}), "test")
        self.server.data.job(job).root.mkdir(parents=True, exist_ok=True)
        self.server.data.job(job).volume.write_bytes(b"values")

    def delete(self, path, **query):
        return self.http.delete(path, params=query)

    def files(self):
        data = self.server.data
        return [
            path for path in (data.scan_file(self.scan), *(data.job(job).root for job in self.jobs)) if path.exists()
        ]

    @property
    def jobs(self):
        return self.first, self.second, self.export

    def is_gone(self, *paths):
        return [self.http.get(path).status_code for path in paths] == [404] * len(paths)

    def left(self):
        with self.server.database.read() as session:
            return session.scalar(select(func.count()).select_from(RemovalRow))


@pytest.fixture
def bench(server, http, request):
    return Bench(server, http, 3 + len(request.node.name) % 60)


def test_delete_with_dependents_returns_409_and_lists_them(bench):
    chain = [
        (f"/masks/{bench.mask}", {f"/api/v1/plans/{bench.plan}"}),
        (f"/plans/{bench.plan}", {f"/api/v1/scans/{bench.scan}"}),
        (f"/scans/{bench.scan}", {f"/api/v1/reconstructions/{job}" for job in (bench.first, bench.second)}),
        (f"/reconstructions/{bench.first}", {f"/api/v1/jobs/{bench.export}"}),
    ]
    for path, needed in chain:
        answer = bench.delete(path)
        assert (answer.status_code, answer.json()["code"]) == (409, "has-dependents"), answer.text
        assert needed <= set(answer.json()["dependents"])
        assert bench.http.get(path).status_code == 200
    assert len(bench.files()) == 4


def test_all_that_depends_on_a_mask_goes_with_it_when_asked_for_and_events_say_so(bench):
    before = EventLog(bench.server.database).bounds().last
    assert bench.delete(f"/masks/{bench.mask}", dependents=True).status_code == 204
    nouns = [f"/masks/{bench.mask}", f"/plans/{bench.plan}", f"/scans/{bench.scan}"]
    assert bench.is_gone(*nouns, *(f"/jobs/{job}" for job in bench.jobs), f"/reconstructions/{bench.first}")
    assert bench.files() == []
    until(lambda: bench.left() == 0)  # the queue may still be opening
    events = EventLog(bench.server.database).after(before, 100)
    deleted = {(event.kind, event.resource_id) for event in events if event.data["state"] == "deleted"}
    assert deleted == {
        ("scan", bench.scan),
        ("reconstruction", bench.first),
        ("reconstruction", bench.second),
        ("job", bench.export),
    }
    assert bench.delete(f"/masks/{bench.mask}").status_code == 404
    assert bench.http.post("/masks", json=GRID | {"count": 5}).status_code in {200, 201}, "it can be made again"


def test_the_images_that_jobs_shared_go_with_their_scan(bench):
    image = bench.server.data.reference(f"{bench.scan}-0123")
    other = bench.server.data.reference("sother-0123")
    for path in (image, other):
        path.write_bytes(b"volume")
    assert bench.delete(f"/scans/{bench.scan}", dependents=True).status_code == 204
    until(lambda: not image.exists())
    assert other.exists()


def test_one_thing_goes_alone(bench):
    for path in (f"/jobs/{bench.export}", f"/reconstructions/{bench.first}", f"/jobs/{bench.second}"):
        assert bench.delete(path).status_code == 204
        assert bench.is_gone(path)
        assert bench.delete(path).status_code == 404
    assert bench.files() == [bench.server.data.scan_file(bench.scan)]
    assert bench.http.get(f"/scans/{bench.scan}").status_code == 200


def test_delete_running_resource_or_its_dependency_returns_409_in_use(bench):
    queued = bench.add_scan()
    job = bench.add_job("r", over=False)
    for path in (f"/scans/{queued}", f"/reconstructions/{job}", f"/scans/{bench.scan}", f"/masks/{bench.mask}"):
        answer = bench.delete(path, dependents=True)
        assert (answer.status_code, answer.json()["code"]) == (409, "in-use"), answer.text
        assert {queued, job} & set(answer.json()["detail"].replace(",", " ").replace(";", " ").split())
    assert len(bench.files()) == 4
    assert bench.http.put(f"/scans/{queued}/desired-state", json={"state": "aborted"}).status_code == 200


def test_an_upload_that_an_import_waits_for_stays(bench):
    upload = bench.http.post("/uploads", content=b"x").json()["id"]
    job = bench.http.post("/jobs", json={"kind": "import", "upload_id": upload}).json()["id"]
    answer = bench.delete(f"/uploads/{upload}")
    assert (answer.status_code, job in answer.json()["detail"]) == (409, True)
    assert bench.http.put(f"/jobs/{job}/desired-state", json={"state": "cancelled"}).status_code == 200
    assert bench.delete(f"/uploads/{upload}").status_code == 204


def test_batch_counts_deleted_members_and_is_deleted_with_remaining(bench):
    body = {"scan_id": bench.scan, "vary": {"sound_speed": [1480, 1500]}, "parameters": {"modes": 8}}
    batch = bench.http.post("/batches", json=body).json()
    members = [job["id"] for job in batch["jobs"]]
    for member in members:
        bench.finish(member)
    assert bench.delete(f"/reconstructions/{members[0]}").status_code == 204
    left = bench.http.get(f"/batches/{batch['id']}").json()
    assert (left["state"], left["counts"]) == ("succeeded", {"succeeded": 1, "forgotten": 1})
    assert [job["id"] for job in left["jobs"]] == members[1:]
    assert bench.delete(f"/batches/{batch['id']}").json()["dependents"] == [f"/api/v1/reconstructions/{members[1]}"]
    assert bench.delete(f"/batches/{batch['id']}", dependents=True).status_code == 204
    assert bench.is_gone(f"/batches/{batch['id']}", f"/reconstructions/{members[1]}")


@pytest.mark.long
def test_a_deletion_that_is_killed_before_the_files_went_is_finished_at_the_next_start(tmp_path):
    server = api_of(tmp_path)
    server.wait()
    with httpx.Client(base_url=f"{server.url}/api/v1", timeout=250) as http:
        until(lambda: httpx.get(f"{server.url}/readyz", timeout=250).json()["checks"]["queue"])
        bench = Bench(server, http, 4)
        blocked = server.data.job(bench.first)
        with blocked.hold_running_lock():  # its process is still dying: the files stay for now
            assert bench.delete(f"/reconstructions/{bench.second}").status_code == 204
            assert bench.delete(f"/reconstructions/{bench.first}", dependents=True).status_code == 204
            assert bench.is_gone(f"/reconstructions/{bench.first}", f"/jobs/{bench.first}")
            assert blocked.volume.exists()
            assert bench.left() == 1
            os.kill(server.process.pid, signal.SIGKILL)
            server.process.wait()
    server.close()
    again = api_of(tmp_path)
    try:
        again.wait()
        until(lambda: not blocked.root.exists())
        bench.server = again
        until(lambda: bench.left() == 0)
    finally:
        again.close()
    assert "Traceback" not in again.log


@pytest.mark.long
def test_a_deletion_cut_at_any_point_leaves_no_row_without_its_file(tmp_path):
    """Killed at a random moment of many deletions: a scan is whole, or gone; what is left of the files goes too."""
    server = api_of(tmp_path)
    server.wait()
    with httpx.Client(base_url=f"{server.url}/api/v1", timeout=250) as http:
        bench = Bench(server, http, 4)
        scans = [bench.add_scan(ScanState.COMPLETE) for _ in range(12)]
        pid = os.fork()
        if not pid:
            time.sleep(0.1)
            os.kill(server.process.pid, signal.SIGKILL)
            os._exit(0)
        try:
            for scan in scans:
                http.delete(f"/scans/{scan}")
        except httpx.HTTPError:
            pass
        os.waitpid(pid, 0)
        server.process.wait()
    server.close()
    again = api_of(tmp_path)
    try:
        again.wait()
        bench.server = again
        until(lambda: bench.left() == 0)
        with httpx.Client(base_url=f"{again.url}/api/v1", timeout=250) as http:
            for scan in scans:
                there = http.get(f"/scans/{scan}").status_code == 200
                assert again.data.scan_file(scan).exists() == there
    finally:
        again.close()


def test_concurrent_file_removals_keep_later_removal_request(server):
    """SQLite gives the number of the last note that is gone to the next one."""
    data, database = server.data, server.database
    first, second = (f"j{uuid.uuid4().hex[:26]}" for _ in range(2))
    remove_files(database, data, FolderBlobStore(data), lambda _jobs: None)  # what earlier tests left

    def note(job):
        data.job(job).root.mkdir(parents=True)
        with database.write() as session:
            session.add(RemovalRow(kind="job", resource_id=job))

    def meanwhile(_jobs):
        remove_files(database, data, FolderBlobStore(data), lambda _jobs: None)
        note(second)

    note(first)
    remove_files(database, data, FolderBlobStore(data), meanwhile)
    remove_files(database, data, FolderBlobStore(data), lambda _jobs: None)
    assert not data.job(first).root.exists()
    assert not data.job(second).root.exists()
