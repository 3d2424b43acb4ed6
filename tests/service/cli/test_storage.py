"""``steradian storage``: what holds how much, and deleting as the API does it."""

import sqlite3
from contextlib import closing

import pytest
from sqlalchemy import text
from typer.testing import CliRunner

from steradian.cli.app import app
from steradian.core.exceptions import Conflict, InvalidInput, NotFound
from steradian.core.settings import Settings
from steradian.jobs.job import JobRequest, Succeeded
from steradian.jobs.queue.dbos import migrate_queue
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.repositories.deletion import InUse


@pytest.fixture
def ledger(tmp_path):
    settings = Settings.create(data=tmp_path)
    migrate_queue(settings)
    database = Database(metadata_url(settings))
    ledger = JobLedger(database)
    with database.write() as session:
        ledger.add(session, JobRequest("j1", "sound-speed", {}))
        ledger.add(session, JobRequest("j2", "sound-speed", {}))
    ledger.finish_attempt("j1", ledger.start_attempt("j1", "test").fence, Succeeded({}), "test")
    data = DataDirectory(tmp_path)
    data.job("j1").root.mkdir()
    (data.job("j1").root / "curve.csv").write_bytes(bytes(3_000_000))
    data.scan_file("s1").write_bytes(bytes(5_000_000))
    yield ledger
    database.close()


def test_the_folder_is_that_of_the_environment_as_for_the_service(ledger, tmp_path):
    found = CliRunner().invoke(app, ["storage", "show"], env={"STERADIAN_DATA": str(tmp_path)})
    assert "free on the disk" in found.stdout, found.exception


def test_storage_delete_with_mismatched_data_folder_is_refused(ledger, tmp_path, tmp_path_factory):
    elsewhere = DataDirectory(tmp_path_factory.mktemp("elsewhere"))
    elsewhere.create()
    elsewhere.job("j1").root.mkdir()
    with closing(sqlite3.connect(elsewhere.metadata_file)) as copy:
        with closing(sqlite3.connect(DataDirectory(tmp_path).metadata_file)) as original:
            original.backup(copy)
    found = CliRunner().invoke(app, ["storage", "delete", "job", "j1", "--data", str(elsewhere.root)])
    assert isinstance(found.exception, InvalidInput)
    assert elsewhere.job("j1").root.is_dir()


def test_the_tables_of_another_version_are_left_as_they_are(ledger, tmp_path):
    database = Database(metadata_url(Settings.create(data=tmp_path)))
    with database.write() as session:
        session.execute(text("UPDATE alembic_version SET version_num = '0007'"))
    found = CliRunner().invoke(app, ["storage", "show", "--data", str(tmp_path)])
    assert isinstance(found.exception, Conflict)
    assert "0007" in str(found.exception)
    assert database.revision() == "0007"
    database.close()


@pytest.mark.long
def test_storage_command_shows_usage_and_deletes_jobs(ledger, tmp_path):
    def run(*words):
        return CliRunner().invoke(app, ["storage", *words, "--data", str(tmp_path)])

    said = run("show").stdout
    for name, size in (
        ("scans", "5 MB"),
        ("other jobs", "3 MB"),
        ("uploads", "0 B"),
    ):
        assert [line.split(name)[1].strip() for line in said.splitlines() if line.startswith(name)] == [size], said
    assert isinstance(run("delete", "job", "j2").exception, InUse)
    assert run("delete", "job", "j1").exit_code == 0
    assert not DataDirectory(tmp_path).job("j1").root.exists()
    assert isinstance(run("delete", "job", "j1").exception, NotFound)
    assert isinstance(run("delete", "thing", "j1").exception, InvalidInput)


def test_an_upload_goes_unless_an_import_has_still_to_read_it(ledger, tmp_path):
    data, database = DataDirectory(tmp_path), Database(metadata_url(Settings.create(data=tmp_path)))
    for name in ("u1", "u2"):
        data.upload(name).write_bytes(b"x")
    with database.write() as session:
        ledger.add(session, JobRequest("j3", "import", {"upload_id": "u1"}))
    database.close()

    def delete(name):
        return CliRunner().invoke(app, ["storage", "delete", "upload", name, "--data", str(tmp_path)])

    assert isinstance(delete("u1").exception, InUse)
    assert delete("u2").exit_code == 0
    for name in ("u2", "../metadata.sqlite"):
        assert isinstance(delete(name).exception, NotFound)
    assert data.upload("u1").is_file()
    assert data.metadata_file.is_file()
