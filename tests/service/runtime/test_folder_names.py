"""Data folders whose names hold characters that mean something in an address, in a shell or in a table."""

import os
import sys

import pytest

from steradian.core.exceptions import InvalidInput
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.maintenance.snapshot import take_snapshot
from steradian.storage.maintenance.startup_check import sqlite_fault
from support.commands import command
from support.services import Service
from support.waiting import until

NAMES = [
    "a?b",
    "a%20b",
    "a%3Fb",
    "a#b",
    "a&b=c",
    "a b",
    "Mäuse",
    "日本",
    "'a' \"b\"",
    "a\nb",
    "[b]",
    "-a",
    "a;b",
    "a\\b",
]
ALL = "a?b#c%20d&e=f ü 'g' \"h\"\n[i]"


@pytest.mark.parametrize("name", NAMES)
def test_database_in_a_folder_of_any_name_lies_in_that_folder(tmp_path, name):
    data = DataDirectory(tmp_path / name)
    data.create()
    database = Database(data.metadata_url)
    database.migrate()
    take_snapshot(database, data.root / "copy.sqlite")
    assert database.name == str(data.metadata_file)
    database.close()
    assert sqlite_fault(data.metadata_file) is None
    reader = Database(data.metadata_url, read_only=True)
    assert reader.revision() is not None
    reader.close()
    assert os.listdir(tmp_path) == [name]


@pytest.mark.skipif(sys.platform != "linux", reason="names of bytes that are no text are Linux's")
def test_metadata_url_of_non_utf8_path_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"data is .*; allowed: a folder whose path is UTF-8 text"):
        DataDirectory(tmp_path / os.fsdecode(b"a\xff")).metadata_url  # noqa: B018


@pytest.mark.long
@pytest.mark.timeout(600)
def test_service_in_a_folder_of_any_name_scans_reconstructs_and_is_backed_up(tmp_path):
    folder, backup, again = (tmp_path / part / ALL for part in ("data", "backup", "restored"))
    folder.parent.mkdir()
    service = Service(folder, log=tmp_path / "log").start()
    try:
        scan = service.make("/scans", plan_id=service.plan())["id"]
        until(lambda: service.get(f"/scans/{scan}").json()["state"] == "complete")
        image = service.done("/reconstructions", scan_id=scan, parameters={"modes": 16})
        for kind in ("hdf5", "nifti", "tiff", "ome-zarr", "vtkhdf", "nrrd", "png"):
            service.done("/jobs", kind="export", reconstruction_id=image["id"], format=kind)
        service.done("/jobs", kind="export", scan_id=scan, format="ipasc")
        uploaded = service.http.post("/uploads", content=(folder / "scans" / f"{scan}.h5").read_bytes()).json()
        service.done("/jobs", kind="import", upload_id=uploaded["id"])
        assert command("backup", backup, "--data", folder).returncode == 0
        shown = command("storage", "show", "--data", folder)
        assert "free on the disk" in shown.stdout
    finally:
        service.close()
    assert sorted(path.name for path in (tmp_path / "data").iterdir()) == [ALL]
    restored = command("restore", backup, again)
    assert restored.returncode == 0, restored.stderr
    for where in (folder, backup, again):
        checked = command("check", where)
        assert (checked.returncode, str(where) in checked.stdout) == (0, True), checked.stdout + checked.stderr
    with_service = Service(again, log=tmp_path / "log").start()
    try:
        assert with_service.get(f"/reconstructions/{image['id']}").json()["state"] == "succeeded"
    finally:
        with_service.close()
