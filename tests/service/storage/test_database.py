import json
import threading

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from sqlalchemy import select, text

from steradian.jobs.queue.job_ledger import JobLedger
from steradian.jobs.registry import JOB_TYPES, resource_of
from steradian.storage.db.database import MIGRATIONS, Database
from steradian.storage.db.tables import Base, MaskRow
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository
from steradian.storage.repositories.scans import ScanRepository


def test_the_migrations_make_exactly_the_tables_that_the_code_uses(database):
    with database.engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []


def test_migrating_twice_changes_nothing(database, plan):
    MaskRepository(database).put(plan.mask)
    database.migrate()
    assert MaskRepository(database).get(plan.mask.id).count == plan.mask.count


def test_readers_do_not_wait_for_a_writer(database):
    with database.engine.connect() as connection:
        assert connection.scalar(text("PRAGMA journal_mode")) == "wal"
    with database.write() as writer:
        writer.execute(text("DELETE FROM masks"))
        with database.read() as reader:
            assert reader.scalars(select(MaskRow)).all() == []


def test_a_failed_write_leaves_nothing(database, plan):
    masks = MaskRepository(database)
    masks.put(plan.mask)

    def fail():
        with database.write() as session:
            session.execute(text("DELETE FROM masks"))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert masks.get(plan.mask.id)


def test_two_processes_worth_of_writers_lose_nothing(tmp_path, database):
    def count_up(other):
        for _ in range(50):
            with other.write() as session:
                value = session.scalar(text("SELECT done FROM counter"))
                session.execute(text("UPDATE counter SET done = :v"), {"v": value + 1})
        other.close()

    with database.write() as session:
        session.execute(text("CREATE TABLE counter (done INTEGER)"))
        session.execute(text("INSERT INTO counter VALUES (0)"))
    threads = [threading.Thread(target=count_up, args=(Database(str(database.engine.url)),)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    with database.read() as session:
        assert session.scalar(text("SELECT done FROM counter")) == 100


EARLIER = {
    "reconstruction": {
        "scan": "scans/s1.h5", "output": "reconstructions/j1", "parameters": {"modes": 16}, "frame": 1,
        "scan_id": "s1", "batch_id": "b1",
    },
    "live": {"scan_id": "s1", "parameters": {}, "interval": 3.0, "batch_id": None},
    "what-if": {"scan_id": "s1", "mask_id": "m1", "points": "exact", "parameters": {}, "batch_id": "b1"},
    "sound-speed": {"scan_id": "s1", "first": 1400.0, "last": 1500.0, "steps": 5, "parameters": {}},
    "quality": {"reconstruction_id": "r1", "reference_id": "r2", "diameter": None, "threshold": 0.04},
    "export": {"reconstruction_id": "r1", "scan_id": None, "format": "nrrd"},
    "import": {"upload_id": "u1", "description": None, "companion_id": None, "labels": {}, "scan_id": "s2",
               "principal": "ada"},
}  # fmt: skip


def earlier(folder, revision):
    """A database as a program of earlier times left it."""
    database = Database(f"sqlite:///{folder / 'earlier.sqlite'}")
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS))
    with database.engine.execution_options(immediate=True).begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, revision)
    return database


def test_migration_assigns_unfinished_scans_to_first_scanner(tmp_path, plan):
    database = earlier(tmp_path, "0014")
    MaskRepository(database).put(plan.mask)
    about = {"plan": PlanRepository(database).put(plan)[0].id, "at": "2026-01-01T00:00:00.000000+00:00"}
    states = {"queued": None, "interrupted": None, "complete": about["at"]}
    with database.engine.execution_options(immediate=True).begin() as connection:
        for state, ended in states.items():
            connection.execute(
                text(
                    "INSERT INTO scans (id, revision, plan_id, mask_id, simulated, labels, fence, state, desired_state,"
                    " created, ended, done, total, history) VALUES (:state, 1, :plan, 'm1', 1, '{}', 0, :state,"
                    " 'running', :at, :ended, 0, 60, '[]')"
                ),
                about | {"state": state, "ended": ended},
            )
        connection.execute(
            text(
                "INSERT INTO scanners (id, revision, simulated, connection, state, since, fence, stopped_at,"
                " stopped_by) VALUES ('scanner-0', 1, 1, 'unknown', 'idle', :at, 3, :at, 'Ada')"
            ),
            about,
        )
    database.migrate()
    scans, scanner = ScanRepository(database), ScannerRepository(database)
    assert {state: scans.get(state).scanner_id for state in states} == {
        "queued": "scanner-0",
        "interrupted": "scanner-0",
        "complete": None,
    }
    assert (scans.next_queued().id, scans.to_resume().id) == ("queued", "interrupted")
    row = scanner.ensure(simulated=True)
    assert (row.stopped_by, row.stop_number, row.fence) == ("Ada", None, 3), "a stop outlives the upgrade"
    database.close()


def test_migration_keeps_previously_queued_jobs_executable(tmp_path):
    database = earlier(tmp_path, "0002")
    with database.engine.execution_options(immediate=True).begin() as connection:
        for kind, payload in EARLIER.items():
            about = {"id": kind, "kind": kind, "payload": json.dumps(payload)}
            connection.execute(
                text(
                    "INSERT INTO jobs (id, revision, kind, payload, priority, submitted, state, desired_state, created,"
                    " attempt, attempts, done, total, history) VALUES (:id, 1, :kind, :payload, 100, 1, 'queued',"
                    " 'succeeded', '2026-01-01T00:00:00.000000+00:00', 0, '[]', 0, 0, '[]')"
                ),
                about,
            )
    database.migrate()
    ledger = JobLedger(database)
    for kind in EARLIER:
        row = ledger.get(kind)
        request = JOB_TYPES[kind].request.create(**row.payload)
        assert row.batch_id == EARLIER[kind].get("batch_id")
        if resource_of(kind) == "reconstruction":
            assert (request.kind, request.scan_id) == (kind, "s1")
    assert JOB_TYPES["what-if"].request.create(**ledger.get("what-if").payload).through.mask_id == "m1"
    database.close()
