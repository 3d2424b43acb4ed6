"""The power fails while the service answers: what it has answered is there when the power comes back.

The API process records what it hands to the system and what the system has confirmed as on the disk
(``recorded_api.py``). It is killed, and for moments chosen by chance a folder is made of what was confirmed by then and
of some of the rest, sector by sector.
"""

import contextlib
import pickle
import random
import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
import uuid
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from sqlalchemy import create_engine, select, text

from steradian.core.settings import Settings
from steradian.jobs.queue.dbos import queue_url
from steradian.jobs.queue.queue_client import JobQueue
from steradian.scans.file.writer import create_scan_file
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.db.tables import Base
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState

pytestmark = pytest.mark.long

SECTOR = 512
CUTS = 40
MAIN = Path(__file__).with_name("recorded_api.py")


@dataclass
class Told:
    """One answer of the service, and how far its record had come when the answer was here."""

    at: int
    path: str
    status: int
    body: dict
    key: str = ""


class Recorded:
    """A data folder, the API on it and what it answered."""

    def __init__(self, folder, plan):
        self.folder, self.base, self.record = folder / "data", folder / "base", folder / "record"
        self.settings = Settings.create(data=self.folder)
        data = DataDirectory(self.folder)
        data.create()
        database = Database(data.metadata_url)
        database.migrate()
        MaskRepository(database).put(plan.mask)
        row, _ = PlanRepository(database).put(plan)
        scans = ScanRepository(database)
        self.plan, self.scan = plan.id, scans.queue(row, simulated=True).id
        for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.COMPLETING, ScanState.COMPLETE):
            scans.transition(
                self.scan, state, why="test", summary={"points": plan.mask.count, "stored": plan.mask.count}
            )
        create_scan_file(data.scan_file(self.scan), plan)
        database.close()
        self.queue = JobQueue(self.settings)  # its tables too are from before
        self.queue.close()
        shutil.copytree(self.folder, self.base)
        self.told, self._lock = [], threading.Lock()

    @contextlib.contextmanager
    def serving(self):
        with socket.create_server(("127.0.0.1", 0)) as listener:
            url = f"http://127.0.0.1:{listener.getsockname()[1]}"
            process = subprocess.Popen(
                [sys.executable, str(MAIN), str(self.record), str(listener.fileno())],
                env=self.settings.environment(),
                stdin=subprocess.PIPE,
                pass_fds=[listener.fileno()],
            )
        try:
            with httpx.Client(base_url=url, timeout=250) as http:
                deadline = time.monotonic() + 90
                while not self.is_ready(http):
                    assert time.monotonic() < deadline, "the API did not start"
                    time.sleep(0.05)
                yield url
        finally:
            process.kill()
            process.wait()
            process.stdin.close()

    @staticmethod
    def is_ready(http):
        with contextlib.suppress(httpx.HTTPError):
            return http.get("/readyz").json()["checks"]["queue"]
        return False

    def ask(self, http, method, path, key="", **how):
        headers = {"Idempotency-Key": key} if key else {}
        answer = http.request(method, f"/api/v1{path}", headers=headers, **how)
        at = self.record.stat().st_size
        assert answer.is_success, answer.text
        told = Told(at, path, answer.status_code, answer.json(), key)
        with self._lock:
            self.told.append(told)
        return told.body

    def work(self, url, number):
        """What a client does; all of it is answered."""
        scan = {"scan_id": self.scan}
        with httpx.Client(base_url=url, timeout=250) as http:
            for turn in range(4):
                equi = {"arrangement": "grid", "aperture": 0.01, "count": 3 + 4 * number + turn, "interval": 3e-4}
                mask = self.ask(http, "POST", "/masks", json=equi)
                plan = self.ask(http, "POST", "/plans", json={"mask_id": mask["id"], "samples": 256})
                run = self.ask(http, "POST", "/scans", uuid.uuid4().hex, json={"plan_id": plan["id"]})
                self.ask(http, "PATCH", f"/scans/{run['id']}", json={"labels": {"turn": str(turn)}})
                self.ask(http, "PUT", f"/scans/{run['id']}/desired-state", json={"state": "aborted"})
                self.ask(http, "POST", "/reconstructions", uuid.uuid4().hex, json=scan | {"parameters": {"modes": 8}})
                self.ask(http, "POST", "/batches", json=scan | {"vary": {"sound_speed": [1480, 1500 + turn]}})
                upload = self.ask(http, "POST", "/uploads", content=bytes([number, turn]) * 3000)
                self.ask(http, "POST", "/jobs", json={"kind": "import", "upload_id": upload["id"]})


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    from steradian.masks import grid_mask
    from steradian.plans import ScanPlan

    made = Recorded(tmp_path_factory.mktemp("cut"), ScanPlan.create(mask=grid_mask(0.01, 3, 1e-3), samples=64))
    with made.serving() as url:
        threads = [threading.Thread(target=made.work, args=(url, number)) for number in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(made.told) == 2 * 4 * 9
    return made


class Disk:
    """What the record says of the folder at one moment."""

    def __init__(self, recorded, until, chance):
        self.folder, self.chance = recorded.folder, chance
        self.durable = {
            str(self.folder / path.relative_to(recorded.base)): bytearray(path.read_bytes())
            for path in recorded.base.rglob("*")
            if path.is_file() and path.suffix != ".sqlite-shm"
        }
        self.pending, self.renamed, self.confirmed = {}, [], {}
        for event in events(recorded.record, until):
            self.apply(*event)

    def apply(self, kind, path, *more):
        match kind:
            case "write" | "truncate":
                self.pending.setdefault(path, []).append((kind, *more))
            case "sync":
                self.durable[path] = self.settled(path, lambda: True)
                self.pending.pop(path, None)
            case "delete":
                self.durable.pop(path, None)
                self.pending.pop(path, None)
            case "file" if more[0] is not None:
                self.confirmed[path] = more[0]
            case "file":  # a folder: the names in it are there to stay
                for source, target in self.renamed:
                    if str(Path(target).parent) == path and source in self.confirmed:
                        self.durable[target] = bytearray(self.confirmed.pop(source))
            case "replace":
                self.renamed.append((path, more[0]))

    def settled(self, path, is_there):
        """The file with what was not confirmed, each sector of it or not."""
        image = bytearray(self.durable.get(path, b""))
        for kind, *more in self.pending.get(path, ()):
            if kind == "truncate":
                if is_there():
                    del image[more[0] :]
                continue
            offset, data = more
            image.extend(bytes(max(0, offset + len(data) - len(image))))
            for at in range(0, len(data), SECTOR):
                if is_there():
                    image[offset + at : offset + at + SECTOR] = data[at : at + SECTOR]
        return image

    def write_to(self, folder):
        for path in self.durable.keys() | self.pending.keys():
            target = folder / Path(path).relative_to(self.folder)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(self.settled(path, lambda: self.chance.random() < 0.5))
        return Settings.create(data=folder)


def events(record, until):
    with record.open("rb") as file:
        while file.tell() < until:
            yield pickle.loads(file.read(struct.unpack("<I", file.read(4))[0]))  # noqa: S301 - our own


def lost(settings, told):
    """Name what was answered and is not in a folder."""
    data = DataDirectory(settings.data)
    database = Database(data.metadata_url)
    database.migrate()
    missing = []
    try:
        with database.read() as session:
            for one in told:
                noun, identifier = one.path.split("/")[1], one.body["id"]
                if noun == "uploads":
                    is_there = data.upload(identifier).is_file() and data.upload(identifier).stat().st_size == 6000
                else:
                    row = select(Base.metadata.tables["jobs" if noun == "reconstructions" else noun]).filter_by(
                        id=identifier
                    )
                    found = session.execute(row).mappings().one_or_none()
                    is_there = found is not None and is_as_told(one, found)
                if not is_there:
                    missing.append(f"{one.status} {one.path}")
    finally:
        database.close()
    return missing


def is_as_told(one, row):
    if one.path.endswith("/desired-state"):
        return row["desired_state"] == "aborted"
    if one.path.count("/") == 2:
        return row["labels"] == one.body["labels"]
    return True


def test_answered_requests_survive_power_cut(recorded, tmp_path):
    chance, missing = random.Random(3), {}
    end = recorded.record.stat().st_size
    moments = [one.at for one in chance.sample(recorded.told, CUTS - 1)] + [end]
    for number, moment in enumerate(moments):
        settings = Disk(recorded, moment, chance).write_to(tmp_path / str(number))
        told = [one for one in recorded.told if one.at <= moment]
        if gone := lost(settings, told):
            missing[moment] = f"{len(gone)} of {len(told)}: {gone[:3]}"
    assert not missing, f"answered and lost in {len(missing)} of {CUTS} cuts: {list(missing.values())[:4]}"


def test_the_queue_has_every_job_that_was_answered(recorded, tmp_path):
    told = [one for one in recorded.told if one.path in {"/reconstructions", "/batches", "/jobs"}]
    jobs = {job["id"] for one in told for job in one.body.get("jobs", [one.body])}
    settings = Disk(recorded, recorded.record.stat().st_size, random.Random(4)).write_to(tmp_path)
    queue = JobQueue(settings)
    queue.reconcile()
    queue.close()
    engine = create_engine(queue_url(settings))
    with engine.connect() as connection:
        queued = set(connection.scalars(text("SELECT workflow_uuid FROM workflow_status WHERE status = 'ENQUEUED'")))
    engine.dispose()
    assert jobs <= queued
