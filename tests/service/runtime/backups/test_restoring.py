"""What is restored of a backup is a data folder like any other."""

import json

import pytest
from typer.testing import CliRunner

from steradian.cli.app import app
from steradian.core.exceptions import Conflict
from steradian.core.settings import Settings
from steradian.jobs.job import JobRequest
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.runtime.backups import create_backup, restore
from steradian.security.keys import KeyStore, Scope, Unauthorized
from steradian.security.sessions import SessionStore
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database, metadata_url
from support.backups import files, once, restored, rows


def test_restore_keeps_rows_and_files_with_new_folder_identity(made, tmp_path):
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


def test_restore_invalidates_sessions_and_keeps_api_keys(kept, tmp_path):
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


@pytest.mark.long
def test_a_backup_goes_from_one_kind_of_database_to_the_other_and_back(made, tmp_path, postgres):
    kept, backup = made
    distributed = restored(backup, tmp_path / "distributed", postgres.database())
    assert not (distributed.data / "steradian.sqlite").exists()
    database = Database(metadata_url(distributed))
    with database.write() as session:
        JobLedger(database).add(session, JobRequest("next", "sound-speed", {}))  # numbered after all others
    made_there = tmp_path / "backup"
    assert create_backup(DataDirectory(distributed.data), database, made_there).jobs == 4
    embedded = Database(metadata_url(restored(made_there, tmp_path / "embedded")))
    (there, _), (here, _) = rows(database), rows(embedded)
    first = kept.database()
    (before, _) = rows(first)
    assert here == there
    assert here | {"jobs": here["jobs"][:3], "events": before["events"]} == before
    for each in (database, embedded, first):
        each.close()


def test_a_database_with_rows_and_a_folder_with_files_are_left_alone(made, tmp_path, postgres):
    kept, backup = made
    settings = Settings.create(data=tmp_path / "new", database_url=postgres.database())
    restore(backup, settings)
    with pytest.raises(Conflict, match="holds"):
        restore(backup, settings.model_copy(update={"data": tmp_path / "other"}))
    assert not (tmp_path / "other").exists()
    with pytest.raises(Conflict, match="not empty"):
        restore(backup, kept.settings)


def test_restore_locks_data_directory_against_concurrent_use(made, tmp_path):
    kept, backup = made
    new = Settings.create(data=tmp_path / "new")

    def others():
        with pytest.raises(Conflict, match="in use"):
            restore(backup, new, cancelled=lambda: True)
        with pytest.raises(Conflict, match="in use"), DataDirectory(new.data).lock():
            pass

    assert restore(backup, new, progress=once(others)) == []
    assert files(new.data) == files(kept.folder)


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
