"""What is no whole backup, or holds what none does, is not restored."""

import json

import pytest
from sqlalchemy import text

from steradian.core.exceptions import DamagedFile
from steradian.core.settings import Settings
from steradian.runtime.backups import Manifest, create_backup, restore
from steradian.runtime.backups.manifest import DATABASE


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
        assert [found[0] for found in Manifest.read(backup).verify(backup)] == [path]
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
        (lambda text: None, "not a finished one"),
    ],
)
def test_restore_of_backup_with_invalid_manifest_is_refused(made, tmp_path, spoil, said):
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
    create_backup(kept.data, database, tmp_path / "backup")
    database.close()
    with pytest.raises(DamagedFile, match="newer version"):
        restore(tmp_path / "backup", Settings.create(data=tmp_path / "new"))
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    "name", ["lock", "restoring.new/x", "run/owner.json", "steradian.sqlite", ".", "database.sqlite/x"]
)
def test_restore_with_unexpected_path_in_manifest_is_refused(made, tmp_path, name):
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
