"""What is deleted while something that needs it is being made: one of the two is refused, naming the other."""

import asyncio
import threading
import uuid
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta

import httpx
import pytest
from sqlalchemy import select, text

from steradian.api.app import create_app
from steradian.api.background.retention import apply_retention
from steradian.core.settings import Settings
from steradian.jobs.job import JobRequest, Succeeded
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.db.tables import JobRow, MaskRow, PlanRow, ScannerRow, ScanRow
from steradian.storage.repositories.event_log import append_event
from steradian.storage.repositories.references import Resource, lock_dependents
from steradian.storage.state_machines import DesiredScanState, ScanState
from support.waiting import until

GRID = {"arrangement": "grid", "aperture": 0.01, "interval": 1e-4}
SMALL = {"modes": 8}
SPEED = {"kind": "sound-speed", "first": 1450, "last": 1550}


def ask(app, method, path, **more):
    """Ask an application in this process."""

    async def answered():
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1/api/v1", timeout=60) as http:
            return await http.request(method, path, **more)

    return asyncio.run(answered())


class Bench:
    """The application in this process, on a database of its own; nothing else runs."""

    def __init__(self, folder, url):
        settings = Settings.create(data=folder, database_url=url)
        database = Database(metadata_url(settings))
        database.migrate()
        database.close()
        self.app = create_app(settings)
        self.services, self.made = self.app.state.services, 2
        self.services.data.create()
        self.services.scanner.ensure(simulated=True)

    def ask(self, method, path, **more):
        return ask(self.app, method, path, **more)

    def post(self, path, **body):
        return self.ask("POST", path, json=body, headers={"Idempotency-Key": uuid.uuid4().hex})

    def make(self, path, **body):
        answer = self.post(path, **body)
        assert answer.status_code in {201, 202}, answer.text
        return answer.json()["id"]

    def mask(self):
        self.made += 1
        return self.make("/masks", **GRID, count=self.made)

    def plan(self):
        return self.make("/plans", mask_id=self.mask(), samples=64)

    def scan(self):
        scan = self.make("/scans", plan_id=self.plan())
        for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.COMPLETING, ScanState.COMPLETE):
            summary = {"points": 9, "stored": 9, "fired": 9}
            self.services.scans.transition(scan, state, why="test", summary=summary)
        self.services.data.scan_file(scan).write_bytes(b"A-lines")
        return scan

    def image(self):
        image = self.make("/reconstructions", scan_id=self.scan(), parameters=SMALL)
        ledger = self.services.ledger
        ledger.finish_attempt(image, ledger.start_attempt(image, "test").fence, Succeeded({}), "test")
        self.services.data.job(image).root.mkdir()
        self.services.data.job(image).volume.write_bytes(b"values")
        return image

    def delete(self, kind, identifier):
        self.services.deletion.delete(kind, identifier, "ada", dependents=True, check=lambda _kinds: None)


@pytest.fixture(scope="module", params=["sqlite", pytest.param("postgres", marks=pytest.mark.long)])
def bench(request, tmp_path_factory):
    url = request.getfixturevalue("postgres").database() if request.param == "postgres" else None
    bench = Bench(tmp_path_factory.mktemp("races"), url)
    yield bench
    bench.services.close()


@pytest.mark.parametrize(
    ("kind", "path", "body"),
    [
        ("mask", "/plans", lambda mask: {"mask_id": mask, "samples": 64}),
        ("plan", "/scans", lambda plan: {"plan_id": plan}),
        ("scan", "/reconstructions", lambda scan: {"scan_id": scan, "parameters": SMALL}),
        (
            "scan",
            "/batches",
            lambda scan: {"scan_id": scan, "vary": {"sound_speed": [1480]}, "parameters": SMALL},
        ),
        ("scan", "/jobs", lambda scan: SPEED | {"scan_id": scan, "parameters": SMALL}),
        ("image", "/jobs", lambda image: {"kind": "export", "reconstruction_id": image, "format": "nifti"}),
        ("image", "/jobs", lambda image: {"kind": "quality", "reconstruction_id": image, "reference_id": image}),
    ],
)
def test_creation_with_concurrently_deleted_dependency_returns_404(bench, monkeypatch, kind, path, body):
    needed = getattr(bench, kind)()
    keeper, name = (
        (bench.services.plans, "put_columns") if path == "/plans" else (bench.services.idempotency, "run_once")
    )
    keep = getattr(keeper, name)

    def meanwhile(*arguments):
        bench.delete({"image": "reconstruction"}.get(kind, kind), needed)
        return keep(*arguments)

    monkeypatch.setattr(keeper, name, meanwhile)
    answer = bench.post(path, **body(needed))
    assert (answer.status_code, answer.json()["code"]) == (404, "not-found"), answer.text
    assert needed in answer.json()["detail"]


def test_a_mask_to_look_through_that_is_deleted_meanwhile_is_a_404(bench, monkeypatch):
    scan, mask, once = bench.scan(), bench.mask(), bench.services.idempotency.run_once

    def meanwhile(*arguments):
        bench.delete("mask", mask)
        return once(*arguments)

    monkeypatch.setattr(bench.services.idempotency, "run_once", meanwhile)
    body = {"scan_id": scan, "through": {"mask_id": mask}, "parameters": SMALL}
    answer = bench.post("/reconstructions", **body)
    assert (answer.status_code, mask in answer.json()["detail"]) == (404, True), answer.text


@pytest.mark.parametrize("bench", [pytest.param("postgres", marks=pytest.mark.long)], indirect=True)
def test_deletion_waits_for_concurrent_creation_then_returns_409(bench):
    mask, plan = bench.mask(), bench.services.plans.get(bench.plan())
    copy = {column.name: getattr(plan, column.name) for column in PlanRow.__table__.columns} | {"mask_id": mask}
    answers = []
    deleting = threading.Thread(target=lambda: answers.append(bench.ask("DELETE", f"/masks/{mask}")))
    with bench.services.database.write() as session:
        session.add(PlanRow(**copy | {"sequence": None, "id": "pnew"}))
        session.flush()
        deleting.start()
        wait_for_a_lock(session)
    deleting.join(60)
    assert (answers[0].status_code, answers[0].json()["code"]) == (409, "has-dependents"), answers[0].text
    assert answers[0].json()["dependents"] == ["/api/v1/plans/pnew"]


def wait_for_a_lock(session, count=1):
    """Wait until so many wait for a lock."""
    waiting = "SELECT count(DISTINCT pid) FROM pg_locks WHERE NOT granted"
    until(lambda: session.scalar(text(waiting)) >= count)


@pytest.mark.parametrize("bench", [pytest.param("postgres", marks=pytest.mark.long)], indirect=True)
@pytest.mark.parametrize(
    ("path", "look"),
    [
        ("/reconstructions", lambda mask: {"through": {"mask_id": mask}, "parameters": SMALL}),
        ("/batches", lambda mask: {"vary": {"mask_id": [mask]}, "parameters": SMALL}),
    ],
)
def test_concurrent_deletion_and_job_creation_do_not_deadlock(bench, path, look):
    """Both go from masks to scans to the event log, so whoever comes second holds nothing that the first one needs."""
    scan = bench.scan()
    mask, answers = bench.services.scans.get(scan).mask_id, []
    making = threading.Thread(target=lambda: answers.append(bench.post(path, scan_id=scan, **look(mask))))
    with bench.services.database.write() as session:
        session.execute(select(MaskRow.id).where(MaskRow.id == mask).with_for_update())  # a deletion begins so
        making.start()
        wait_for_a_lock(session)
        assert Resource("scan", scan) in lock_dependents(session, Resource("mask", mask))
        append_event(session, bench.services.clock(), "scan", scan, {"state": "looked at"})
    making.join(60)
    assert answers[0].status_code == 202, answers[0].text


@pytest.mark.parametrize("bench", [pytest.param("postgres", marks=pytest.mark.long)], indirect=True)
def test_deletions_that_share_dependents_never_wait_for_each_other(bench):
    """A what-if depends on its mask and on its scan: who deletes the mask holds it only when all scans are held."""
    scan = bench.scan()
    mask = bench.services.scans.get(scan).mask_id
    bench.make("/reconstructions", scan_id=scan, through={"mask_id": mask}, parameters=SMALL)
    answers = []
    deleting = threading.Thread(
        target=lambda: answers.append(bench.ask("DELETE", f"/masks/{mask}", params={"dependents": "true"}))
    )
    with bench.services.database.write() as session:
        session.execute(select(ScanRow.id).where(ScanRow.id == scan).with_for_update())  # a deletion begins so
        deleting.start()
        wait_for_a_lock(session)
        assert len(lock_dependents(session, Resource("scan", scan))) == 2
    deleting.join(60)
    assert (answers[0].status_code, answers[0].json()["code"]) == (409, "in-use"), answers[0].text


@pytest.mark.parametrize("bench", [pytest.param("postgres", marks=pytest.mark.long)], indirect=True)
@pytest.mark.parametrize(("kind", "status"), [("reconstruction", 404), ("mask", 204)])
def test_deletion_after_concurrent_deletion_treats_resource_as_gone(bench, kind, status):
    services, scan = bench.services, bench.scan()
    mask = services.scans.get(scan).mask_id
    image = bench.make("/reconstructions", scan_id=scan, through={"mask_id": mask}, parameters=SMALL)
    services.ledger.finish_attempt(image, services.ledger.start_attempt(image, "test").fence, Succeeded({}), "test")
    first = mask if kind == "mask" else image
    answers = []
    deleting = threading.Thread(
        target=lambda: answers.append(bench.ask("DELETE", f"/{kind}s/{first}", params={"dependents": "true"}))
    )
    with services.database.write() as session:
        going = lock_dependents(session, Resource("reconstruction", image))
        deleting.start()
        wait_for_a_lock(session)
        services.deletion.delete_rows(session, going, "ada", "requested")
    deleting.join(60)
    assert answers[0].status_code == status, answers[0].text


@pytest.mark.parametrize("first", ["deletion", "retention"])
def test_concurrent_deletion_and_retention_do_not_deadlock(bench, monkeypatch, first):
    """They touch the same three jobs; one in the middle is held until both wait, whichever came first."""
    services, scan, name = bench.services, bench.scan(), uuid.uuid4().hex
    made = [
        JobRequest(f"{name}m", "reconstruction", {"scan_id": scan}),
        JobRequest(f"{name}z", "reconstruction", {"scan_id": scan}),
        JobRequest(f"{name}a", "export", {"reconstruction_id": f"{name}m", "format": "nifti"}),
    ]
    for request in made:
        with services.database.write() as session:
            services.ledger.add(session, request)
        services.ledger.finish_attempt(
            request.id, services.ledger.start_attempt(request.id, "test").fence, Succeeded({}), "test"
        )
    now = services.clock()
    monkeypatch.setattr(services, "clock", lambda: now + timedelta(days=31))
    monkeypatch.setattr(services, "settings", services.settings.model_copy(update={"retention_days": 30}))
    both = {"retention": lambda: apply_retention(services), "deletion": lambda: bench.delete("scan", scan)}
    order = [both.pop(first), *both.values()]
    with ThreadPoolExecutor(2) as pool:
        with services.database.write() as session:
            session.execute(select(JobRow.id).where(JobRow.id == made[0].id).with_for_update())
            asked = []
            for count, work in enumerate(order, 1):
                asked.append(pool.submit(work))
                if services.database.engine.dialect.name == "postgresql":  # SQLite's one writer is waited for unseen
                    wait_for_a_lock(session, count)
        for work in asked:
            work.result(60)
    with services.database.read() as session:
        assert not session.scalars(select(JobRow.id).where(JobRow.id.startswith(name))).all()


@pytest.mark.parametrize("bench", [pytest.param("postgres", marks=pytest.mark.long)], indirect=True)
def test_concurrent_emergency_stop_and_resume_do_not_deadlock(bench):
    scan, services = bench.make("/scans", plan_id=bench.plan()), bench.services
    for state in (ScanState.ARMING, ScanState.RUNNING):
        services.scans.transition(scan, state, why="test")
    services.scans.set_desired_state(scan, DesiredScanState.PAUSED, None)
    answers = []
    put = {"json": {"state": "running"}}
    going_on = threading.Thread(target=lambda: answers.append(bench.ask("PUT", f"/scans/{scan}/desired-state", **put)))
    with services.database.write() as session:
        session.execute(select(ScannerRow.id).with_for_update())  # a stop begins so
        going_on.start()
        wait_for_a_lock(session)
        session.execute(select(ScanRow.id).where(ScanRow.id == scan).with_for_update())
    going_on.join(60)
    assert answers[0].json()["desired_state"] == "running", answers[0].text
