"""Backups: whole or not there, of one moment, and what is restored of one is a data folder like any other."""

import copy
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select, text
from typer.testing import CliRunner

from steradian.cli.app import app
from steradian.errors import Cancelled, Conflict, DamagedFile, DiskFull, InvalidInput
from steradian.jobs.ledger import JobLedger
from steradian.jobs.model import JobRequest, Succeeded
from steradian.plans import ScanPlan
from steradian.runtime.backups import Manifest, back_up, restore
from steradian.runtime.backups.manifest import DATABASE
from steradian.scans.check import check_scan_file
from steradian.scans.store import AlineStore, create_scan_file
from steradian.security.keys import KeyStore, Scope, Unauthorized
from steradian.security.sessions import SessionStore
from steradian.settings import Settings
from steradian.storage.arrays import Folder
from steradian.storage.database import Database, metadata_url
from steradian.storage.deletion import Deletion, remove_files
from steradian.storage.emergency import EmergencyLatch
from steradian.storage.paths import DataDirectory
from steradian.storage.plans import PlanRepository
from steradian.storage.scans import ScanRepository
from steradian.storage.states import ScanState
from steradian.storage.tables import Table
from support.alines import Aline
from support.damage import BITS
from support.damage import spoil as spoil_header
from support.disks import small_disk
from support.kept import Kept

LONG = 1 << 16
"""Samples of an A-line, so that nine of them are more than is copied at a time."""


class Whole(Kept):
    """A kept folder with an upload, a key, and a job that waits, and backups of it."""

    def __init__(self, folder):
        super().__init__(folder)
        database = self.database()
        self.key = KeyStore(database).create("ada", [Scope.ADMIN])
        self.data.upload("u1").write_bytes(b"recorded" * 1000)
        with database.write() as session:
            JobLedger(database).add(session, JobRequest("waits", "import", {"upload_id": "u1"}))
        database.close()
        EmergencyLatch(self.data.emergency).press("ada", "smoke")
        self.serve()  # binds folder and database

    def at(self, folder):
        """The same in another folder."""
        shutil.copytree(self.folder, folder)
        other = copy.copy(self)
        other.settings = Settings.create(data=folder)
        other.folder, other.data, other.file = folder, DataDirectory(folder), folder / "steradian.sqlite"
        return other

    def back_up(self, to, **how):
        database = self.database()
        try:
            return back_up(self.data, database, to, **how)
        finally:
            database.close()

    def running_scan(self):
        """A scan under way, all of whose 9 A-lines are stored."""
        database = self.database()
        scans = ScanRepository(database)
        plan = ScanPlan.create(mask=self.plan.mask, samples=LONG)
        row, _ = PlanRepository(database).put(plan)
        scan = scans.queue(row, simulated=True).id
        for state in (ScanState.ARMING, ScanState.RUNNING):
            scans.transition(scan, state, why="test")
        database.close()
        create_scan_file(self.data.scan_file(scan), plan, scan_id=scan, simulated=True)
        with AlineStore(self.data.scan_file(scan)) as store:
            store.append([aline(point) for point in range(9)])
        return scan


def aline(point):
    return Aline(point, np.full(LONG, 100 + point, np.int16), point + 1)


def spoil(store, row):
    """Overwrite the samples of a row as somebody who measures it again does halfway."""
    chunk, within = divmod(row, store._chunk_rows)
    os.pwrite(store._handle, b"\x55" * 64, store._chunks[chunk] + 2 * LONG * within)


def rows(database):
    """Everything in the tables, but for what tells two databases apart."""
    with database.read() as session:
        found = {
            table.name: session.execute(select(table).order_by(*table.primary_key)).mappings().all()
            for table in Table.metadata.sorted_tables
        }
    found["event_log"] = {row["name"]: row["value"] for row in found["event_log"]}
    return found | {"event_log": found["event_log"].keys()}, found["event_log"]


def files(folder):
    kinds = ("scans", "jobs", "uploads", "emergency-stop")
    paths = [path for kind in kinds for path in (folder / kind).rglob("*") if path.is_file() and path.name != "lock"]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder and a backup of it, which no test changes."""
    folder = tmp_path_factory.mktemp("made")
    kept = Whole(folder / "data")
    kept.back_up(folder / "backup")
    return kept, folder / "backup"


@pytest.fixture
def kept(made, tmp_path):
    return made[0].at(tmp_path / "data")


@pytest.fixture
def small(tmp_path):
    with small_disk(tmp_path / "small") as folder:
        yield folder


def restored(backup, folder, url=None):
    settings = Settings.create(data=folder, database_url=url)
    assert restore(backup, settings) == []
    return settings


def test_what_is_restored_is_all_there_was_as_a_folder_of_its_own(made, tmp_path):
    kept, backup = made
    settings = restored(backup, tmp_path / "elsewhere")
    first, second = kept.database(), Database(metadata_url(settings))
    (before, facts), (after, others) = rows(first), rows(second)
    assert after == before
    assert others["folder"] != facts["folder"]
    assert others["folder"] == (settings.data / "identity").read_text()
    assert others["epoch"] != facts["epoch"], "whoever followed the original's events is told to begin anew"
    assert KeyStore(second).check(kept.key).may(Scope.ADMIN)
    first.close()
    second.close()
    assert files(settings.data) == files(kept.folder)
    assert {path.stat().st_mode & 0o077 for path in (backup, settings.data)} == {0}, "for this user alone"


def test_nobody_is_signed_in_where_a_backup_is_restored(kept, tmp_path):
    database = kept.database()
    keys = KeyStore(database)
    cookie = SessionStore(database, keys).open(keys.check(kept.key))
    SessionStore(database, keys).check(cookie)
    database.close()
    kept.back_up(tmp_path / "backup")
    elsewhere = Database(metadata_url(restored(tmp_path / "backup", tmp_path / "elsewhere")))
    keys = KeyStore(elsewhere)
    with pytest.raises(Unauthorized):
        SessionStore(elsewhere, keys).check(cookie)
    assert keys.check(kept.key).may(Scope.ADMIN)
    elsewhere.close()


def test_a_disk_that_is_full_already_is_told_with_what_is_needed(kept, small):
    (small / "else").write_bytes(bytes(shutil.disk_usage(small).free - 8192))
    with pytest.raises(DiskFull, match=r"the backup needs \d+\.\d MB") as told:
        kept.back_up(small / "backup")
    assert told.value.needed > sum(len(content) for content in files(kept.folder).values())
    assert told.value.available <= 8192
    assert [path.name for path in small.iterdir()] == ["else"]


def test_a_disk_that_somebody_else_fills_meanwhile_is_told_as_such(kept, small):
    def fill(*_):
        (small / "else").write_bytes(bytes(shutil.disk_usage(small).free))

    with pytest.raises(DiskFull, match="became full"):
        kept.back_up(small / "backup", progress=fill)
    assert [path.name for path in small.iterdir()] == ["else"]


def test_a_backup_goes_from_one_kind_of_database_to_the_other_and_back(made, tmp_path, postgres):
    kept, backup = made
    distributed = restored(backup, tmp_path / "distributed", postgres.database())
    assert not (distributed.data / "steradian.sqlite").exists()
    database = Database(metadata_url(distributed))
    with database.write() as session:
        JobLedger(database).add(session, JobRequest("next", "sound-speed", {}))  # numbered after all others
    made_there = tmp_path / "backup"
    assert back_up_of(distributed, database, made_there).jobs == 4
    embedded = Database(metadata_url(restored(made_there, tmp_path / "embedded")))
    (there, _), (here, _) = rows(database), rows(embedded)
    first = kept.database()
    (before, _) = rows(first)
    assert here == there
    assert here | {"jobs": here["jobs"][:3], "events": before["events"]} == before
    for each in (database, embedded, first):
        each.close()


def back_up_of(settings, database, to):
    return back_up(DataDirectory(settings.data), database, to)


def test_a_database_with_rows_and_a_folder_with_files_are_left_alone(made, tmp_path, postgres):
    kept, backup = made
    settings = Settings.create(data=tmp_path / "new", database_url=postgres.database())
    restore(backup, settings)
    with pytest.raises(Conflict, match="holds"):
        restore(backup, settings.model_copy(update={"data": tmp_path / "other"}))
    assert not (tmp_path / "other").exists()
    with pytest.raises(Conflict, match="not empty"):
        restore(backup, kept.settings)


@pytest.mark.parametrize("path", ["identity", DATABASE, "uploads/u1", "jobs/first/volume.h5", "emergency-stop/pressed"])
@pytest.mark.parametrize("damage", ["changed", "cut", "missing"])
def test_a_backup_with_one_bad_file_is_refused_whole(made, tmp_path, path, damage):
    _, backup = made
    target = backup / path
    whole = target.read_bytes()
    try:
        match damage:
            case "changed":
                target.write_bytes(bytes([whole[0] ^ 1]) + whole[1:])
            case "cut":
                target.write_bytes(whole[:-1])
            case "missing":
                target.unlink()
        assert [found[0] for found in Manifest.read(backup).faults(backup)] == [path]
        with pytest.raises(DamagedFile, match=path):
            restore(backup, Settings.create(data=tmp_path / "new"))
        assert not (tmp_path / "new").exists()
    finally:
        target.write_bytes(whole)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda text: text[: len(text) // 2], "cannot be read"),
        (lambda text: text.replace('"version": 1', '"version": 2'), "this program reads"),
        (lambda text: text.replace('"uploads/u1"', '"../u1"'), "no backup holds"),
        (lambda text: "[]", "cannot be read"),
        (lambda text: None, "was not finished"),
    ],
)
def test_what_is_no_whole_backup_is_not_restored(made, tmp_path, spoil, said):
    _, backup = made
    manifest = backup / "manifest.json"
    whole = manifest.read_text()
    try:
        manifest.unlink() if spoil(whole) is None else manifest.write_text(spoil(whole))
        with pytest.raises(DamagedFile, match=said):
            restore(backup, Settings.create(data=tmp_path / "new"))
    finally:
        manifest.write_text(whole)


def test_the_backup_of_a_newer_program_is_refused_with_words(kept, tmp_path):
    database = kept.database()
    with database.write() as session:
        session.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    back_up(kept.data, database, tmp_path / "backup")
    database.close()
    with pytest.raises(DamagedFile, match="newer version"):
        restore(tmp_path / "backup", Settings.create(data=tmp_path / "new"))
    assert not (tmp_path / "new").exists()


KILLED = """
import os, sys
from pathlib import Path
from steradian.runtime.backups import back_up
from steradian.storage.database import Database
from steradian.storage.paths import DataDirectory
data, seen = DataDirectory(Path(sys.argv[1])), []
def die(*at):
    seen.append(at)
    if len(seen) > 4:
        os._exit(9)
back_up(data, Database(data.metadata_url), Path(sys.argv[2]), progress=die)
"""


@pytest.mark.long
def test_a_killed_backup_is_none_and_does_not_hinder_the_next(kept, tmp_path):
    backup = tmp_path / "backup"
    assert subprocess.run([sys.executable, "-c", KILLED, str(kept.folder), str(backup)]).returncode == 9
    left = tmp_path / "backup.new"
    assert left.is_dir()
    assert not backup.exists()
    with pytest.raises(DamagedFile, match="was not finished"):
        restore(left, Settings.create(data=tmp_path / "new"))
    kept.back_up(backup)
    assert list(Manifest.read(backup).faults(backup)) == []
    assert not left.exists()


def test_a_stopped_backup_or_restoration_leaves_nothing(made, tmp_path):
    kept, backup = made
    asked = iter([False, False, True])
    with pytest.raises(Cancelled):
        kept.back_up(tmp_path / "stopped", cancelled=lambda: next(asked))
    asked = iter([False, False, True])
    with pytest.raises(Cancelled):
        restore(backup, Settings.create(data=tmp_path / "new"), cancelled=lambda: next(asked))
    assert list(tmp_path.iterdir()) == []


def test_of_two_backups_to_one_place_the_second_is_refused_and_the_first_is_whole(kept, tmp_path):
    def another():
        with pytest.raises(Conflict, match="another backup"):
            kept.back_up(tmp_path / "backup", cancelled=lambda: True)

    kept.back_up(tmp_path / "backup", progress=once(another))
    assert list(Manifest.read(tmp_path / "backup").faults(tmp_path / "backup")) == []
    assert {path.name for path in tmp_path.iterdir()} == {"data", "backup"}


def test_nobody_else_comes_into_a_folder_that_is_being_restored(made, tmp_path):
    kept, backup = made
    new = Settings.create(data=tmp_path / "new")

    def others():
        with pytest.raises(Conflict, match="in use"):
            restore(backup, new, cancelled=lambda: True)
        with pytest.raises(Conflict, match="in use"), DataDirectory(new.data).lock():
            pass

    assert restore(backup, new, progress=once(others)) == []
    assert files(new.data) == files(kept.folder)


@pytest.mark.parametrize(
    "name", ["lock", "restoring.new/x", "run/owner.json", "steradian.sqlite", ".", "database.sqlite/x"]
)
def test_a_manifest_that_names_what_no_backup_holds_is_refused(made, tmp_path, name):
    _, backup = made
    manifest = backup / "manifest.json"
    whole = manifest.read_text()
    try:
        manifest.write_text(whole.replace('"uploads/u1"', json.dumps(name)))
        with pytest.raises(DamagedFile, match="no backup holds"):
            restore(backup, Settings.create(data=tmp_path / "new"))
        assert not (tmp_path / "new").exists()
    finally:
        manifest.write_text(whole)


def test_a_manifest_without_a_database_is_refused(made, tmp_path):
    _, backup = made
    manifest = backup / "manifest.json"
    whole = manifest.read_text()
    try:
        document = json.loads(whole)
        del document["files"][DATABASE]
        manifest.write_text(json.dumps(document))
        with pytest.raises(DamagedFile, match=DATABASE):
            restore(backup, Settings.create(data=tmp_path / "new"))
    finally:
        manifest.write_text(whole)


def test_what_others_may_not_read_is_theirs_no_more_in_a_backup(kept, tmp_path):
    """Also where the program that calls leaves files open to others."""
    before = os.umask(0o022)
    try:
        kept.back_up(tmp_path / "backup")
        restored(tmp_path / "backup", tmp_path / "new")
    finally:
        os.umask(before)
    for folder in (tmp_path / "backup", tmp_path / "new"):
        assert folder.stat().st_mode & 0o077 == 0, "nobody else comes to the files in it"


def test_a_backup_goes_to_a_new_folder_outside_of_what_it_copies(kept, tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(Conflict, match="exists"):
        kept.back_up(tmp_path / "there")
    with pytest.raises(InvalidInput, match="outside"):
        kept.back_up(kept.folder / "backup")


def once(deed):
    """A deed that is done when the first bytes are copied."""
    done = []

    def progress(*_):
        if not done:
            done.append(deed)
            deed()

    return progress


def test_what_is_deleted_while_it_is_copied_is_in_neither_rows_nor_files(kept, tmp_path):
    def delete():
        database = kept.database()
        Deletion(database).delete("scan", kept.scan, "test", dependents=True, check=lambda _kinds: None)
        remove_files(database, kept.data, Folder(kept.data), lambda _jobs: None)
        database.close()

    made = kept.back_up(tmp_path / "backup", progress=once(delete))
    assert (made.scans, made.jobs) == (0, 1)
    restored(tmp_path / "backup", tmp_path / "new")
    assert set(files(tmp_path / "new")) == {"uploads/u1"} | {
        f"emergency-stop/{name}" for name in ("pressed", "released", "answered")
    }


def test_an_import_that_ends_meanwhile_is_done_or_has_its_upload(kept, tmp_path):
    def finish():
        database = kept.database()
        ledger = JobLedger(database)
        ledger.settle("waits", ledger.start("waits", "worker-0").fence, Succeeded({"scan_id": "s1"}), "worker-0")
        database.close()
        kept.data.upload("u1").unlink()

    kept.back_up(tmp_path / "backup", progress=once(finish))
    settings = restored(tmp_path / "backup", tmp_path / "new")
    database = Database(metadata_url(settings))
    assert JobLedger(database).get("waits").state == "succeeded"
    database.close()


def test_what_a_running_job_has_written_is_left_out_since_it_runs_again(kept, tmp_path):
    database = kept.database()
    ledger = JobLedger(database)
    with database.write() as session:
        ledger.add(session, JobRequest("runs", "reconstruction", {"scan_id": kept.scan}))
    row = ledger.start("runs", "worker-0")
    folder = kept.data.job("runs")
    folder.begin(row.fence + 1)  # a later start, which the rows of the backup do not know
    folder.log.write_text("first start\n")
    folder.volume.write_bytes(b"half")
    folder.report.write_text("{}")
    database.close()
    kept.back_up(tmp_path / "backup")
    settings = restored(tmp_path / "backup", tmp_path / "new")
    assert [path.name for path in (settings.data / "jobs" / "runs").iterdir()] == ["log.txt"]


def test_a_scan_is_copied_while_it_is_written_with_all_that_was_stored(kept, tmp_path):
    """An A-line that is measured again is found halfway by the first copy, and whole by the second."""
    scan = kept.running_scan()
    file, draft = kept.data.scan_file(scan), tmp_path / "backup.new" / "scans" / f"{scan}.h5"
    seen = []

    def write(*at):
        if not draft.exists():
            return
        seen.append(at)
        with AlineStore(file) as store:
            if len(seen) == 1:
                spoil(store, 8)
            else:
                store.append([aline(store._order.tolist().index(8))])

    made = kept.back_up(tmp_path / "backup", progress=write)
    assert made.damaged == {}
    assert len(seen) > 2, "it was copied in several pieces, and more than once"
    settings = restored(tmp_path / "backup", tmp_path / "new")
    copied = check_scan_file(settings.data / "scans" / f"{scan}.h5")
    assert (copied.is_sound, copied.intact) == (True, 9)


def test_a_scan_that_is_damaged_already_is_kept_and_named(kept, tmp_path):
    scan = kept.running_scan()
    with AlineStore(kept.data.scan_file(scan)) as store:
        spoil(store, 8)
    other = kept.running_scan()
    kept.data.scan_file(other).write_bytes(b"no HDF5")
    made = kept.back_up(tmp_path / "backup")
    assert made.damaged.keys() == {scan, other}
    assert made.damaged[scan].startswith("1 A-line")
    restored(tmp_path / "backup", tmp_path / "new")
    assert (tmp_path / "new" / "scans" / f"{other}.h5").read_bytes() == b"no HDF5"


@pytest.mark.parametrize("bit", BITS)
def test_a_scan_with_a_damaged_header_is_kept_as_it_is(kept, tmp_path, bit):
    scan = kept.running_scan()
    file = kept.data.scan_file(scan)
    spoil_header(file, "alines/status", bit)
    made = kept.back_up(tmp_path / "backup")
    assert "is kept as it is" in made.damaged[scan]
    assert (tmp_path / "backup" / "scans" / file.name).read_bytes() == file.read_bytes()
    assert list(made.faults(tmp_path / "backup")) == []


def test_a_log_of_the_database_that_goes_while_it_is_looked_at_ends_no_backup(kept, tmp_path, monkeypatch):
    """SQLite removes it when the last one closes the file."""
    stat, log = Path.stat, Path(f"{kept.file}-wal")

    def gone_since(path, **more):
        found = stat(path, **more)
        if path == log:
            log.unlink()
        return found

    log.write_bytes(b"")
    monkeypatch.setattr(Path, "stat", gone_since)
    assert kept.back_up(tmp_path / "backup").scans == 1


def test_a_person_backs_up_checks_and_restores(kept, tmp_path):
    def run(*words):
        return CliRunner().invoke(app, words, env={"STERADIAN_DATA": str(kept.folder)}, catch_exceptions=False)

    backup, new = str(tmp_path / "backup"), str(tmp_path / "new")
    assert "1 scans and 3 jobs" in run("backup", backup).stdout
    assert "every file is as it was" in run("check", backup).stdout
    found = run("restore", backup, new)
    assert (found.exit_code, f"{backup} restored in {new}" in found.stdout) == (0, True)
    kept.data.job("first").volume.unlink()
    run("backup", f"{backup}-2")
    found = run("restore", f"{backup}-2", f"{new}-2")
    assert (found.exit_code, "missing-result" in found.stdout) == (3, True), "what was missing before is told"
    (tmp_path / "backup" / "identity").write_text("another")
    found = run("check", backup, "--json")
    assert (found.exit_code, json.loads(found.stdout)["findings"][0]["kind"]) == (3, "damaged-backup")
