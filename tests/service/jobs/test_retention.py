"""What is too old is forgotten, and nothing else."""

import logging
import os
from datetime import UTC, datetime, timedelta

import pytest

from steradian.api.background.retention import apply_retention
from steradian.api.services import ServiceContainer
from steradian.core.settings import Settings
from steradian.jobs.job import Failed, JobRequest, Succeeded
from steradian.jobs.requests import ImportRequest, to_job_request
from steradian.masks import grid_mask
from steradian.plans import ScanPlan
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.db.tables import EventRow
from steradian.storage.maintenance.clock_trust import HELD, TrustedClock
from steradian.storage.state_machines import ReconstructionState


class Clock:
    def __init__(self):
        self.now = datetime(2026, 1, 2, tzinfo=UTC)
        self.wrong = 0.0
        """Seconds by which it was put ahead: a steady clock does not have them."""

    def jump(self, **by):
        self.now += timedelta(**by)
        self.wrong += timedelta(**by).total_seconds()

    def __call__(self):
        return self.now


class Engine:
    """Stands for the queue's engine, which forgets what it is told to."""

    def __init__(self):
        self.forgotten = []

    def forget(self, job_ids):
        self.forgotten += job_ids

    def close(self):
        pass


@pytest.fixture
def services(tmp_path):
    settings = Settings.create(data=tmp_path, retention_days=30, event_days=7)
    database = Database(metadata_url(settings))
    services = ServiceContainer(settings, Clock())
    services.data.create()
    database.migrate()
    database.close()
    services.ages = TrustedClock(services.clock, steady=lambda: services.clock.now.timestamp() - services.clock.wrong)
    assert services.ages.can_be_trusted(services.database)
    services._queue = Engine()
    services._opened.set()
    yield services
    services.close()


def job(services, name, *, over):
    with services.database.write() as session:
        services.ledger.add(session, JobRequest(name, "reconstruction", {}))
    services.ledger.start_attempt(name, "worker-0")
    if over:
        services.ledger.finish_attempt(name, 1, Succeeded({}), "worker-0")
    folder = services.data.job(name).root
    folder.mkdir(parents=True)
    (folder / "volume.h5").write_bytes(b"x")
    return folder


def test_finished_jobs_go_with_their_files_after_their_time_and_others_stay(services):
    old, running = job(services, "old", over=True), job(services, "running", over=False)
    services.clock.now += timedelta(days=29)
    young = job(services, "young", over=True)
    apply_retention(services)
    assert old.exists()
    services.clock.now += timedelta(days=2)
    apply_retention(services)
    assert (old.exists(), running.exists(), young.exists()) == (False, True, True)
    assert services.queue.forgotten == ["old"]
    assert {row.id for row in services.ledger.page(10).rows} == {"running", "young"}
    assert services.ledger.status("running").state is ReconstructionState.RUNNING


def test_scans_and_masks_are_never_forgotten(services):
    plan = ScanPlan.create(mask=grid_mask(0.01, 3, 1e-3), samples=64)
    services.masks.put(plan.mask)
    row, _ = services.plans.put(plan)
    scan = services.scans.queue(row, simulated=True)
    services.data.scan_file(scan.id).write_bytes(b"x")
    services.clock.now += timedelta(days=4000)
    apply_retention(services)
    assert services.scans.get(scan.id)
    assert services.masks.get(plan.mask.id)
    assert services.data.scan_file(scan.id).exists()


def test_retention_disabled_keeps_all_jobs(services):
    services.settings = services.settings.model_copy(update={"retention_days": None})
    folder = job(services, "old", over=True)
    services.clock.now += timedelta(days=4000)
    apply_retention(services)
    assert folder.exists()


def test_retention_deletes_unused_uploads_after_one_day(services):
    paths = [services.data.upload(name) for name in ("u1", "u2")]
    for path, age in zip(paths, (timedelta(hours=25), timedelta(hours=1)), strict=True):
        path.write_bytes(b"x")
        then = (services.clock.now - age).timestamp()
        os.utime(path, (then, then))
    apply_retention(services)
    assert [path.exists() for path in paths] == [False, True]


def test_an_upload_that_an_import_waits_for_stays_until_it_is_over(services):
    path, beside = services.data.upload("u1"), services.data.upload("u2")
    then = (services.clock.now - timedelta(hours=25)).timestamp()
    for one in (path, beside):
        one.write_bytes(b"x")
        os.utime(one, (then, then))
    with services.database.write() as session:
        services.ledger.add(session, to_job_request("j1", ImportRequest.create(upload_id="u1", companion_id="u2")))
    apply_retention(services)
    assert (path.exists(), beside.exists()) == (True, True)
    services.ledger.request_cancellation("j1", "ada", None)
    services.ledger.cancelled("j1", "ada")
    apply_retention(services)
    assert (path.exists(), beside.exists()) == (False, False)


def test_events_can_be_replayed_for_as_long_as_was_chosen(services):
    job(services, "first", over=True)
    services.clock.now += timedelta(days=6)
    job(services, "second", over=True)
    services.clock.now += timedelta(days=2)
    apply_retention(services)
    with services.database.read() as session:
        left = {row.resource_id for row in session.query(EventRow)}
    assert left == {"second"}
    assert services.log.bounds().before > 0


def test_retention_deletes_drafts_of_ended_jobs_only(services):
    over, running, dying = (
        job(services, "over", over=True),
        job(services, "running", over=False),
        job(services, "dying", over=True),
    )
    for folder in (over, running, dying):
        (folder / "volume.h5.1.new").write_bytes(b"half")
    with services.data.job("dying").hold_running_lock():
        (dying / "volume.h5.1.new").write_bytes(b"half")
        apply_retention(services)
        assert [len(list(folder.glob("*.new"))) for folder in (over, running, dying)] == [0, 1, 1]
    apply_retention(services)
    assert [len(list(folder.glob("*.new"))) for folder in (over, running, dying)] == [0, 1, 0]
    assert [(folder / "volume.h5").exists() for folder in (over, running, dying)] == [True] * 3


def test_a_result_that_a_waiting_job_has_still_to_read_stays_until_that_is_over(services):
    image, reference, other = (job(services, name, over=True) for name in ("image", "reference", "other"))
    exports = [
        JobRequest("j1", "export", {"reconstruction_id": "image", "format": "nifti"}),
        JobRequest("j2", "quality", {"reconstruction_id": "image", "reference_id": "reference"}),
    ]
    with services.database.write() as session:
        for export in exports:
            services.ledger.add(session, export)
    services.clock.now += timedelta(days=31)
    apply_retention(services)
    assert [folder.exists() for folder in (image, reference, other)] == [True, True, False]
    assert {row.id for row in services.ledger.page(10).rows} == {"image", "reference", "j1", "j2"}
    for export in exports:
        services.ledger.request_cancellation(export.id, "ada", None)
        services.ledger.cancelled(export.id, "ada")
    apply_retention(services)
    assert [folder.exists() for folder in (image, reference)] == [False, False]


@pytest.mark.long
def test_retention_deletes_import_drafts_of_killed_jobs_only(services):
    """A draft is a file, or the folder in which a file is read; a scan that is to run has one too."""
    scans, plan = services.data.root / "scans", ScanPlan.create(mask=grid_mask(0.01, 3, 1e-3), samples=64)
    services.masks.put(plan.mask)
    armed = services.scans.queue(services.plans.put(plan)[0], simulated=True).id
    for name in ("j1", "j2", "j3"):
        with services.database.write() as session:
            services.ledger.add(session, JobRequest(name, "import", {"upload_id": "u1"}))
        services.ledger.start_attempt(name, "worker-0")
    for name in ("j1", "j3"):
        services.ledger.finish_attempt(name, 1, Failed("timeout", "it took too long"), "worker-0")
    drafts = [
        scans / f"{scan}.h5{ending}" for scan in ("s1", "s2", "s3", "s4") for ending in (".1.new", ".2.new.importing")
    ]
    for draft in drafts:
        if draft.suffix == ".importing":
            draft.mkdir()
            (draft / "half.h5").write_bytes(b"half")
        else:
            draft.write_bytes(b"half")
    for scan in ("s1.h5", f"{armed}.h5.new"):
        (scans / scan).write_bytes(b"A-lines")
    with services.data.job("j3").hold_running_lock():  # cancelled, and its process is still dying
        apply_retention(services)
        assert [draft.exists() for draft in drafts] == [False, False, True, True, True, True, False, False]
    apply_retention(services)
    left = {path.name for path in scans.iterdir()}
    assert left == {"s1.h5", "s2.h5.1.new", "s2.h5.2.new.importing", f"{armed}.h5.new"}


def lines(caplog, level=logging.WARNING):
    """Return the log's lines from a level on, whatever level another test has left."""
    ours = [record for record in caplog.records if record.name.startswith("steradian") and record.levelno >= level]
    return [record.getMessage() for record in ours]


def started(services):
    """Forget the clock as a start does."""
    services.ages = TrustedClock(services.clock, steady=lambda: services.clock.now.timestamp())


def test_each_retention_deletion_is_logged_with_reason(services, caplog):
    job(services, "old", over=True)
    path = services.data.upload("u1")
    path.write_bytes(b"x")
    os.utime(path, (services.clock.now.timestamp(),) * 2)
    services.clock.now += timedelta(days=31)
    caplog.set_level("INFO", logger="steradian")
    caplog.clear()
    apply_retention(services)
    assert lines(caplog, logging.INFO) == [
        "upload u1 is deleted: it was uploaded at 2026-01-02 00:00:00+00:00, and uploads are kept for one day",
        "reconstruction old is deleted: it ended at 2026-01-02 00:00:00+00:00, more than 30 days ago (retention_days)",
    ]


@pytest.mark.parametrize(("by", "said"), [({"days": 3650}, "ahead"), ({"hours": 2}, "ahead"), ({"hours": -2}, "back")])
def test_nothing_is_deleted_by_its_age_for_a_day_after_the_clock_jumped(services, caplog, by, said):
    folder, path = job(services, "old", over=True), services.data.upload("u1")
    path.write_bytes(b"x")
    services.clock.now += timedelta(days=29, hours=23)
    os.utime(path, ((services.clock.now - timedelta(hours=23)).timestamp(),) * 2)
    apply_retention(services)
    services.clock.jump(**by)
    for _ in range(4):
        apply_retention(services)
        services.clock.now += timedelta(hours=6)
    assert (folder.exists(), path.exists()) == (True, True)
    (told,) = lines(caplog)
    assert f"the clock jumped {said} by" in told
    assert told.endswith("; nothing is deleted by its age for 24 h")
    services.clock.now += timedelta(hours=3)
    apply_retention(services)
    assert (folder.exists(), path.exists()) == (False, False)


def test_nothing_is_deleted_by_its_age_at_a_start_with_a_clock_before_the_newest_record(services, caplog):
    old = job(services, "old", over=True)
    services.clock.now += timedelta(days=365)
    job(services, "young", over=True)
    services.clock.now -= timedelta(days=200)
    started(services)
    apply_retention(services)
    assert old.exists()
    assert "the clock shows 2026-06-16T00:00:00+00:00, before the newest record of 2027-01-02" in lines(caplog)[0]


def test_nothing_is_deleted_by_its_age_for_a_day_after_a_start_with_a_clock_years_ahead(services, caplog):
    old = job(services, "old", over=True)
    services.clock.now += timedelta(days=3650)
    started(services)
    apply_retention(services)
    assert old.exists()
    assert "the newest record is of 2026-01-02T00:00:00+00:00, the clock shows 2035-12-31" in lines(caplog)[0]
    services.clock.jump(days=-3650)  # the network has told the time
    apply_retention(services)
    services.clock.now += HELD
    apply_retention(services)
    assert old.exists()


def test_retention_keeps_jobs_while_clock_is_years_ahead(services, caplog):
    old = job(services, "old", over=True)
    services.clock.now += timedelta(days=3650)
    services.scanner.ensure(simulated=True)
    services.scanner.lease("Ada", 60, None, "local")  # an event by the wrong clock
    started(services)
    apply_retention(services)
    assert old.exists()


def test_jobs_asked_for_while_the_clock_was_ahead_do_not_keep_later_ones_for_ever(services):
    services.clock.now += timedelta(days=1460)
    ahead = job(services, "ahead", over=True)
    services.clock.now -= timedelta(days=1450)
    later = [job(services, f"later{n}", over=True) for n in range(2)]
    services.clock.now += timedelta(days=31)
    job(services, "last", over=True)
    started(services)
    apply_retention(services)
    services.clock.now += HELD
    apply_retention(services)
    assert [folder.exists() for folder in (ahead, *later)] == [True, False, False]


def test_retention_restarts_age_of_records_dated_by_wrong_clock(services, caplog):
    right, folders = services.clock.now, [job(services, "first", over=True)]
    for name, wrong in (("early", datetime(1970, 1, 1, 1, tzinfo=UTC)), ("behind", right - timedelta(days=100))):
        services.clock.now = wrong
        folders.append(job(services, name, over=True))
    path = services.data.upload("u1")
    path.write_bytes(b"x")
    os.utime(path, (3600, 3600))
    services.clock.now = right + timedelta(days=31)
    job(services, "last", over=True)
    services.clock.now += timedelta(hours=2)
    started(services)
    apply_retention(services)
    assert [folder.exists() for folder in folders] == [False, True, True]
    assert path.exists()
    told = [line for line in lines(caplog) if "comes from a wrong clock; its age counts from now on" in line]
    assert sorted(line.split(",")[0] for line in told) == [
        f"the date of {one}" for one in ("job behind", "job early", "upload u1")
    ]
    services.clock.now += timedelta(days=29)
    caplog.clear()
    apply_retention(services)
    assert [folder.exists() for folder in folders] == [False, True, True]
    services.clock.now += timedelta(days=2)
    apply_retention(services)
    assert [folder.exists() for folder in folders] == [False, False, False]
    assert lines(caplog) == []
