"""Which folder a database belongs to survives a power cut, and an identity that did not is one clear sentence."""

import os
import stat

import pytest
from sqlalchemy import event

from steradian.core.exceptions import InvalidInput
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.maintenance.folder_binding import bind_folder, check_binding


@pytest.fixture
def data(tmp_path):
    return DataDirectory(tmp_path)


def test_folder_identity_is_synced_before_database_commit(database, data, monkeypatch):
    seen, sync = [], os.fsync

    def synced(handle):
        sync(handle)
        found = os.fstat(handle)
        seen.append((found.st_ino, "folder" if stat.S_ISDIR(found.st_mode) else found.st_size))

    monkeypatch.setattr(os, "fsync", synced)
    event.listen(database.engine, "commit", lambda _connection: seen.append("committed"))
    bind_folder(database, data)
    file, folder = data.identity_file.stat().st_ino, data.root.stat().st_ino
    assert seen[:3] == [(file, 32), (folder, "folder"), "committed"]
    assert len(data.identity) == 32


def test_an_identity_that_a_power_cut_has_emptied_is_one_clear_sentence(database, data):
    bind_folder(database, data)
    known = data.identity
    data.identity_file.write_text("")
    with pytest.raises(InvalidInput) as refusal:
        check_binding(database, data)
    said = str(refusal.value)
    assert said.endswith(f"write {known} into its file identity, emptied by a power cut")
    data.identity_file.write_text(known)
    assert check_binding(database, data)


def test_a_service_writes_an_emptied_identity_again_where_the_database_lies_in_the_folder(database, data):
    bind_folder(database, data)
    known = data.identity
    data.identity_file.write_text("")
    bind_folder(database, data)
    assert data.identity == known
