"""What a worker makes sure of before it takes jobs: its folder is the database's, and the tables are of its version."""

import os
import sqlite3
import subprocess
import sys
from contextlib import closing

import pytest

from steradian.core.settings import Settings
from steradian.jobs.queue.dbos import migrate_queue
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.maintenance.folder_binding import bind_folder
from steradian.storage.state_machines import ReconstructionState
from support.waiting import until

pytestmark = pytest.mark.long

R = ReconstructionState


def asked(settings, question):
    with closing(sqlite3.connect(DataDirectory(settings.data).metadata_file)) as connection:
        rows = connection.execute(question).fetchall()
        connection.commit()
    return rows


def everything_below(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


WORKERS = {"command": ["steradian", "worker", "--name", "other"], "process": ["steradian.runtime.worker_entry", "0"]}


def ended(settings, *module):
    """Run a worker until it ends by itself; returns its code and all that it said."""
    lifeline, held = os.pipe()  # a worker ends when its standard input does
    done = subprocess.run(
        [sys.executable, "-m", *module],
        env=settings.environment(),
        stdin=lifeline,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=250,
        text=True,
        check=False,
    )
    os.close(lifeline)
    os.close(held)
    return done.returncode, done.stdout


@pytest.fixture(scope="module")
def of_another_folder(postgres, tmp_path_factory):
    """The address of a database that a service has used with a folder of its own."""
    url = postgres.database()
    migrate_queue(Settings.create(data=tmp_path_factory.mktemp("service"), database_url=url))
    return url


@pytest.mark.parametrize("start", list(WORKERS))
@pytest.mark.parametrize("mounted", ["nothing", "an empty folder", "another's folder"])
def test_worker_with_mismatched_data_folder_exits_without_changes(tmp_path, of_another_folder, start, mounted):
    folder = tmp_path / "mount"
    if mounted != "nothing":
        folder.mkdir()
    if mounted == "another's folder":
        (folder / "identity").write_text("0" * 32)
    before = everything_below(tmp_path)
    settings = Settings.create(data=folder, database_url=of_another_folder)
    code, said = ended(settings, *WORKERS[start])
    assert code > 0
    assert "is it mounted there?" in " ".join(said.split())
    assert everything_below(tmp_path) == before


@pytest.mark.parametrize("lacking", ["tables", "a version", "the queue"])
def test_a_worker_waits_for_a_service_of_its_version_and_changes_nothing_meanwhile(
    tmp_path, make_bench, lacking, capfd
):
    settings = Settings.create(data=tmp_path)
    match lacking:
        case "a version":
            asked(settings, "CREATE TABLE other (id INTEGER)")
        case "the queue":
            database = Database(metadata_url(settings))
            database.migrate()
            bind_folder(database, DataDirectory(tmp_path))
            database.close()
    before, tables = everything_below(tmp_path), []
    if lacking != "tables":
        tables = asked(settings, "SELECT name FROM sqlite_master ORDER BY name")
    worker = make_bench.start_worker(settings)
    said = []

    def waits():
        said.append(capfd.readouterr().err)
        return "waiting for the service" in "".join(said)

    try:
        until(waits)
        words = {
            "tables": "there is no database in",
            "a version": "the database has version none, this worker needs",
            "the queue": "its queue is of engine none",
        }
        assert words[lacking] in "".join(said)
        assert [name for name in everything_below(tmp_path) if not name.endswith(("-wal", "-shm"))] == before
        if lacking != "tables":
            assert asked(settings, "SELECT name FROM sqlite_master ORDER BY name") == tables
        service = make_bench(tmp_path)
        service.submit("job", "succeed", answer=1)
        assert service.queue.wait("job", timeout=250).state is R.SUCCEEDED
        service.queue.close()
    finally:
        worker.terminate()
        worker.wait(250)


def test_a_worker_refuses_tables_of_a_newer_service_and_leaves_them(tmp_path):
    settings = Settings.create(data=tmp_path)
    migrate_queue(settings)
    asked(settings, "UPDATE alembic_version SET version_num = '9999'")
    code, said = ended(settings, *WORKERS["process"])
    assert code > 0
    assert "the database has version 9999, this worker knows those up to" in said
    assert "install the service's Steradian" in said
    assert asked(settings, "SELECT version_num FROM alembic_version") == [("9999",)]
