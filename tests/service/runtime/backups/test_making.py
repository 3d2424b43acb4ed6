"""What ends a backup early, and whom it lets at its files: it is whole or not there."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from steradian.core.exceptions import Cancelled, Conflict, DamagedFile, DiskFull, InvalidInput
from steradian.core.settings import Settings
from steradian.runtime.backups import Manifest, restore
from support.backups import files, once, restored


def test_backup_to_full_disk_is_refused_with_required_size(kept, small):
    (small / "else").write_bytes(bytes(shutil.disk_usage(small).free - 8192))
    with pytest.raises(DiskFull, match=r"the backup needs \d+\.\d MB") as told:
        kept.back_up(small / "backup")
    assert told.value.needed > sum(len(content) for content in files(kept.folder).values())
    assert told.value.available <= 8192
    assert [path.name for path in small.iterdir()] == ["else"]


def test_disk_filling_up_during_backup_raises_disk_full(kept, small):
    def fill(*_):
        (small / "else").write_bytes(bytes(shutil.disk_usage(small).free))

    with pytest.raises(DiskFull, match="became full"):
        kept.back_up(small / "backup", progress=fill)
    assert [path.name for path in small.iterdir()] == ["else"]


KILLED = """
import os, sys
from pathlib import Path
from steradian.runtime.backups import create_backup
from steradian.storage.db.database import Database
from steradian.storage.data_dir.layout import DataDirectory
data, seen = DataDirectory(Path(sys.argv[1])), []
def die(*at):
    seen.append(at)
    if len(seen) > 4:
        os._exit(9)
create_backup(data, Database(data.metadata_url), Path(sys.argv[2]), progress=die)
"""


@pytest.mark.long
def test_a_killed_backup_is_none_and_does_not_hinder_the_next(kept, tmp_path):
    backup = tmp_path / "backup"
    assert subprocess.run([sys.executable, "-c", KILLED, str(kept.folder), str(backup)]).returncode == 9
    left = tmp_path / "backup.new"
    assert left.is_dir()
    assert not backup.exists()
    with pytest.raises(DamagedFile, match="not a finished one"):
        restore(left, Settings.create(data=tmp_path / "new"))
    kept.back_up(backup)
    assert list(Manifest.read(backup).verify(backup)) == []
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
    assert list(Manifest.read(tmp_path / "backup").verify(tmp_path / "backup")) == []
    assert {path.name for path in tmp_path.iterdir()} == {"data", "backup"}


def test_backup_and_restored_folders_are_private_to_owner(kept, tmp_path):
    """Also where the program that calls leaves files open to others."""
    before = os.umask(0o022)
    try:
        kept.back_up(tmp_path / "backup")
        restored(tmp_path / "backup", tmp_path / "new")
    finally:
        os.umask(before)
    for folder in (tmp_path / "backup", tmp_path / "new"):
        assert folder.stat().st_mode & 0o077 == 0, "nobody else comes to the files in it"


def test_backup_to_existing_or_nested_folder_is_refused(kept, tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(Conflict, match="exists"):
        kept.back_up(tmp_path / "there")
    with pytest.raises(InvalidInput, match="outside"):
        kept.back_up(kept.folder / "backup")


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
