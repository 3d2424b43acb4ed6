import os
import subprocess
import sys
from pathlib import Path

import pytest

from steradian.core.exceptions import InvalidInput
from steradian.storage.data_dir.layout import DataDirectory, DataDirectoryInUse

HOLD = """
import sys, pathlib
from steradian.storage.data_dir.layout import DataDirectory
with DataDirectory(pathlib.Path(sys.argv[1])).lock():
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"held\n"
        yield process
        process.kill()


def test_lock_of_data_directory_in_use_is_refused_naming_holder(tmp_path, holder):
    with pytest.raises(DataDirectoryInUse, match=f"in use by process {holder.pid}"), DataDirectory(tmp_path).lock():
        pass


def test_a_killed_service_leaves_the_directory_free(tmp_path, holder):
    holder.kill()
    holder.wait()
    with DataDirectory(tmp_path).lock():
        pass


def test_a_file_in_place_of_the_directory_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match=r"data is .*file"):
        DataDirectory(tmp_path / "file").create()


def modes(root):
    return {str(path.relative_to(root)): oct(path.stat().st_mode & 0o777) for path in sorted(root.rglob("*"))}


@pytest.mark.skipif(os.name != "posix", reason="modes are of POSIX systems")
def test_a_data_folder_is_made_for_its_user_alone(tmp_path):
    data = DataDirectory(tmp_path / "some" / "data")
    data.create()
    assert data.root.stat().st_mode & 0o777 == 0o700
    assert set(modes(data.root).values()) == {"0o700"}


@pytest.mark.skipif(os.name != "posix", reason="modes are of POSIX systems")
def test_restrict_permissions_closes_own_files_and_ignores_foreign_ones(tmp_path):
    data = DataDirectory(tmp_path / "data")
    for name in ("scans", "jobs", "run"):
        (data.root / name).mkdir(mode=0o755, parents=True)
    for name in ("steradian.sqlite", "steradian.sqlite-wal", "lock"):
        (data.root / name).write_text("")
        (data.root / name).chmod(0o644)
    data.root.chmod(0o775)
    (data.root / "notes.txt").write_text("a person's")
    (data.root / "notes.txt").chmod(0o644)
    assert data.restrict_permissions() == [f"change {data.root}"]
    left = modes(data.root)
    assert left.pop("notes.txt") == "0o644"
    assert set(left.values()) == {"0o700", "0o600"}
    (data.root / "notes.txt").unlink()
    assert data.restrict_permissions() == []
    assert data.root.stat().st_mode & 0o777 == 0o700


@pytest.mark.skipif(os.name != "posix", reason="modes are of POSIX systems")
def test_restrict_permissions_ignores_vanished_database_log(tmp_path, monkeypatch):
    """SQLite removes it when the last one closes the file."""
    listed, log = Path.iterdir, tmp_path / "steradian.sqlite-wal"

    def gone_since(path):
        found = list(listed(path))
        log.unlink()
        return iter(found)

    for path in (log, tmp_path / "steradian.sqlite"):
        path.write_text("")
        path.chmod(0o644)
    monkeypatch.setattr(Path, "iterdir", gone_since)
    assert DataDirectory(tmp_path).restrict_permissions() == []
    assert (tmp_path / "steradian.sqlite").stat().st_mode & 0o777 == 0o600


def test_a_job_knows_whether_a_process_runs_it(tmp_path):
    job = DataDirectory(tmp_path).job("j1")
    assert not job.is_running
    with job.hold_running_lock():
        assert DataDirectory(tmp_path).job("j1").is_running
    assert not job.is_running


def test_startup_check_accepts_import_interrupted_before_its_row(tmp_path):
    """It was the first scan of the folder; its job goes on with the file."""
    from steradian.core.settings import Settings
    from steradian.jobs.job import JobRequest
    from steradian.jobs.queue.job_ledger import JobLedger
    from steradian.storage.db.database import Database, metadata_url
    from steradian.storage.maintenance.startup_check import check_before_start

    settings, data = Settings.create(data=tmp_path), DataDirectory(tmp_path)
    data.create()
    database = Database(metadata_url(settings))
    database.migrate()
    with database.write() as session:
        JobLedger(database).add(session, JobRequest("j1", "import", {"upload_id": "u1"}))
    database.close()
    data.scan_file("s1").write_bytes(b"A-lines")
    assert check_before_start(settings) == ["s1"]
