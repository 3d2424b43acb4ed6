"""``steradian storage``: what holds how much, and deleting as the API does it."""

import pytest
from typer.testing import CliRunner

from steradian.cli.app import app
from steradian.errors import InvalidInput, NotFound
from steradian.jobs.engine import prepare
from steradian.jobs.ledger import JobLedger
from steradian.jobs.model import JobRequest, Succeeded
from steradian.settings import Settings
from steradian.storage.database import Database, metadata_url
from steradian.storage.deletion import InUse
from steradian.storage.paths import DataDirectory


@pytest.fixture
def ledger(tmp_path):
    settings = Settings.create(data=tmp_path)
    prepare(settings)
    database = Database(metadata_url(settings))
    ledger = JobLedger(database)
    with database.write() as session:
        ledger.add(session, JobRequest("j1", "sound-speed", {}))
        ledger.add(session, JobRequest("j2", "sound-speed", {}, promised=7_000_000))
    ledger.settle("j1", ledger.start("j1", "test").fence, Succeeded({}), "test")
    data = DataDirectory(tmp_path)
    data.job("j1").root.mkdir()
    (data.job("j1").root / "curve.csv").write_bytes(bytes(3_000_000))
    data.scan_file("s1").write_bytes(bytes(5_000_000))
    yield ledger
    database.close()


def test_the_folder_is_that_of_the_environment_as_for_the_service(ledger, tmp_path):
    found = CliRunner().invoke(app, ["storage", "show"], env={"STERADIAN_DATA": str(tmp_path)})
    assert "promised to jobs" in found.stdout, found.exception


def test_storage_shows_what_holds_how_much_and_deletes_it(ledger, tmp_path):
    def run(*words):
        return CliRunner().invoke(app, ["storage", *words, "--data", str(tmp_path)])

    said = run("show").stdout
    for name, size in (("scans", "5 MB"), ("other jobs", "3 MB"), ("promised to jobs", "7 MB"), ("uploads", "0 B")):
        assert [line.split(name)[1].strip() for line in said.splitlines() if line.startswith(name)] == [size], said
    assert isinstance(run("delete", "job", "j2").exception, InUse)
    assert run("delete", "job", "j1").exit_code == 0
    assert not DataDirectory(tmp_path).job("j1").root.exists()
    assert isinstance(run("delete", "job", "j1").exception, NotFound)
    assert isinstance(run("delete", "thing", "j1").exception, InvalidInput)
