"""A data folder that was damaged: one clear sentence at the start, and a command that tells what can be got back."""

import json
import os
import shutil
import sqlite3
import subprocess
import sys

import pytest
from sqlalchemy import select

from steradian.core.exceptions import DamagedFile
from steradian.jobs.job import JobRequest, Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.runtime.fsck import repair
from steradian.storage.db.tables import ScanRow
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.state_machines import ScanState
from support.damage import spoil
from support.kept import Kept

MAIN = [sys.executable, "-c", "from steradian.cli import main; main()"]


def steradian(*command):
    return subprocess.run([*MAIN, *command], capture_output=True, text=True)


@pytest.fixture
def kept(tmp_path):
    return Kept(tmp_path / "data")


def garbage(kept):
    kept.file.write_bytes(b"no database at all " * 5000)


def truncated(kept):
    os.truncate(kept.file, kept.file.stat().st_size // 2 // 4096 * 4096)


def overwritten(kept):
    with kept.file.open("r+b") as file:
        file.seek(3 * 4096)
        file.write(os.urandom(6 * 4096))


def empty(kept):
    kept.file.write_bytes(b"")


def missing(kept):
    kept.file.unlink()


def newer(kept):
    with sqlite3.connect(kept.file) as database:
        database.execute("UPDATE alembic_version SET version_num = '9999'")
    database.close()


def another(kept):
    """The database of another, empty folder."""
    kept.file.unlink()
    database = kept.database()
    database.migrate()
    database.close()


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (truncated, "damaged"),
        (newer, "newer"),
        (another, "knows none of"),
        pytest.param(garbage, "is not an SQLite database", marks=pytest.mark.long),
        pytest.param(overwritten, "damaged", marks=pytest.mark.long),
        pytest.param(empty, "empty", marks=pytest.mark.long),
        pytest.param(missing, "missing", marks=pytest.mark.long),
    ],
)
def test_a_start_on_a_damaged_folder_is_one_clear_sentence(kept, damage, said):
    damage(kept)
    before = kept.file.read_bytes() if kept.file.exists() else None
    with pytest.raises(DamagedFile, match=said) as refused:
        kept.serve()
    assert str(kept.folder) in str(refused.value)
    assert "\n" not in str(refused.value)
    if damage is not newer:
        assert "steradian check" in str(refused.value)
        assert (kept.file.read_bytes() if kept.file.exists() else None) == before, "what may be got back is untouched"


@pytest.mark.long
def test_the_sentence_is_all_that_a_person_sees(kept):
    truncated(kept)
    done = steradian("serve", "--port", "0", "--data", str(kept.folder))
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (3, "", 1), done.stderr


@pytest.mark.long
def test_a_folder_that_is_well_has_nothing_to_report(kept):
    kept.serve()
    assert kept.found() == {}
    done = steradian("check", str(kept.folder))
    assert (done.returncode, "nothing is missing" in done.stdout) == (0, True), done.stdout + done.stderr


@pytest.mark.parametrize(
    "damage",
    [
        truncated,
        *(pytest.param(one, marks=pytest.mark.long) for one in (garbage, overwritten, empty, missing, another)),
    ],
)
def test_check_of_damaged_folder_reports_data_that_repair_restores(kept, damage):
    damage(kept)
    found = kept.found()
    assert "9 of 9 A-lines" in found[kept.scan].text
    if damage is not overwritten:
        assert found["first"].kind == "unknown-result"
    left = {path.name for path in kept.folder.iterdir()}
    assert any(f"{kept.scan} is registered" in line for line in repair(kept.settings))
    database = kept.database()
    with database.read() as session:
        scans = list(session.scalars(select(ScanRow)))
    assert [(scan.id, scan.state, scan.simulated) for scan in scans] == [(kept.scan, ScanState.COMPLETE, True)]
    assert PlanRepository(database).load(scans[0].plan_id) == kept.plan
    database.close()
    if damage not in {missing, empty, another}:
        renamed = {f"steradian.sqlite.damaged-1{ending}" for ending in ("", "-wal", "-shm")}
        assert {path.name for path in kept.folder.iterdir()} - left <= renamed
        assert (kept.folder / "steradian.sqlite.damaged-1").stat().st_size
    assert kept.scan not in kept.found(), "what was repaired is well"
    kept.serve()


def test_half_a_log_of_the_database_is_seen_by_the_volumes_it_forgot(kept):
    """Half a WAL is a valid one to SQLite: the last transactions have not been."""
    database = kept.database()
    reader = sqlite3.connect(kept.file)
    reader.execute("BEGIN")
    reader.execute("SELECT count(*) FROM jobs").fetchall()  # so that the log stays
    ledger = JobLedger(database)
    for name in ("third", "fourth"):
        with database.write() as session:
            ledger.add(session, JobRequest(name, "reconstruction", {"scan_id": kept.scan}))
        if name == "third":
            third = ledger.start_attempt(name, "worker-0")
            log = kept.file.with_name("steradian.sqlite-wal")
            size = log.stat().st_size
        kept.data.job(name).root.mkdir()
        kept.data.job(name).volume.write_bytes(b"values")
        kept.data.job(name).report.write_text("{}")
    kept.finish(ledger, third)
    copy = kept.folder.with_name("copy")
    shutil.copytree(kept.folder, copy, ignore=shutil.ignore_patterns("*-shm"))
    reader.close()
    database.close()
    os.truncate(copy / "steradian.sqlite-wal", size)
    shutil.rmtree(kept.folder)
    copy.rename(kept.folder)
    assert kept.kinds() == {"third": "unfinished-result", "fourth": "unknown-result"}


@pytest.mark.long
def test_the_check_names_rows_without_files_and_files_without_rows(kept):
    shutil.copy(kept.data.scan_file(kept.scan), kept.data.scan_file("s01foreign"))
    (kept.data.root / "scans" / "s01broken.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    kept.data.scan_file(kept.scan).unlink()
    kept.data.job("first").volume.unlink()
    shutil.copytree(kept.data.job("second").root, kept.data.job("stranger").root)
    done = steradian("check", str(kept.folder), "--json")
    found = {finding["subject"]: finding["kind"] for finding in json.loads(done.stdout)["findings"]}
    assert done.returncode == 3
    assert found == kept.kinds()
    assert found == {
        kept.scan: "missing-scan",
        "s01foreign": "unknown-scan",
        "s01broken": "unreadable-scan",
        "first": "missing-result",
        "stranger": "unknown-result",
    }


def test_check_misses_nothing_of_a_series_and_names_a_lost_one(kept):
    database = kept.database()
    ledger = JobLedger(database)
    for name in ("whole", "lost"):
        with database.write() as session:
            ledger.add(session, JobRequest(name, "reconstruction", {"scan_id": kept.scan}))
        row = ledger.start_attempt(name, "worker-0")
        ledger.finish_attempt(name, row.fence, Succeeded({"frames": [{"numbers": [0]}, {"numbers": [1]}]}), "worker-0")
        kept.data.job(name).root.mkdir()
    database.close()
    (kept.data.job("whole").root / "series.h5").write_bytes(b"values")
    found = kept.found()
    assert list(found) == ["lost"]
    assert "series.h5 is gone" in found["lost"].text


def test_service_with_unregistered_scan_starts_and_logs_it(kept, capfd):
    shutil.copy(kept.data.scan_file(kept.scan), kept.data.scan_file("s01foreign"))
    kept.serve()
    said = capfd.readouterr().err
    assert "s01foreign" in said
    assert "steradian check" in said


@pytest.mark.long
def test_a_check_of_a_folder_in_use_or_of_none_is_one_clear_sentence(kept, tmp_path):
    with kept.data.lock():
        done = steradian("check", str(kept.folder))
    assert (done.returncode, "in use" in done.stderr) == (4, True)
    done = steradian("check", str(tmp_path / "nowhere"))
    assert (done.returncode, "nowhere" in done.stderr, (tmp_path / "nowhere").exists()) == (3, True, False)


@pytest.mark.long
def test_check_of_scan_with_damaged_header_reports_unreadable_scan(kept):
    foreign = kept.data.scan_file("s01foreign")
    shutil.copy(kept.data.scan_file(kept.scan), foreign)
    spoil(foreign, "alines/status")
    done = steradian("check", str(kept.folder))
    assert (done.returncode, "s01foreign" in done.stdout, done.stderr) == (3, True, "")
    assert kept.kinds() == {"s01foreign": "unreadable-scan"}
