"""A data folder that an earlier version left opens with today's: what is in it is there, and what waited goes on."""

import json
import os
import sqlite3
import tarfile
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import text

from steradian.core.exceptions import DamagedFile
from steradian.jobs.registry import JOB_TYPES
from steradian.runtime.fsck import check_consistency
from steradian.storage.db.database import Database, known_revisions, metadata_url
from support.services import Service
from support.waiting import until

pytestmark = [pytest.mark.long, pytest.mark.timeout(400)]
EARLIER = sorted(path.name.removesuffix(".tar.xz") for path in (Path(__file__).parent / "data").glob("*.tar.xz"))
"""Versions and databases, as ``0.1.0-0010-embedded``: version, that of its tables, kind of database."""


@pytest.fixture(params=EARLIER)
def left(request, tmp_path):
    """A service on what an earlier one left, not started, and what that one said of it."""
    with tarfile.open(Path(__file__).parent / "data" / f"{request.param}.tar.xz") as archive:
        archive.extractall(tmp_path, filter="data")
    for upload in (tmp_path / "data" / "uploads").iterdir():
        os.utime(upload)  # left just now: one of yesterday is tidied away
    rows, settings = (tmp_path / "rows.sql").read_text(), {}
    if request.param.endswith("postgres"):
        postgres = request.getfixturevalue("postgres")
        settings["database_url"] = postgres.database()
        database = Database(metadata_url(Service(tmp_path / "data", **settings).settings))
        with closing(database.engine.raw_connection()) as connection:
            connection.execute(rows)
            connection.commit()
        database.close()
    else:
        with closing(sqlite3.connect(tmp_path / "data" / "steradian.sqlite")) as connection:
            connection.executescript(rows)
    service = Service(tmp_path / "data", log=tmp_path / "log", simulator_speed=500.0, **settings)
    yield service, json.loads((tmp_path / "said.json").read_text())
    service.close()


def test_an_earlier_folder_opens_with_all_that_is_in_it_and_goes_on(left):
    service, said = left
    assert check_consistency(service.settings) == []
    service.start()
    assert service.get(f"/scans/{said['whole']}").json()["state"] == "complete"
    volume = service.get(f"/reconstructions/{said['volume']}/volume", headers={"Accept": "application/x-npy"})
    assert volume.content.startswith(b"\x93NUMPY")
    assert service.get(f"/uploads/{said['upload']}").json()["bytes"] == said.get("upload_bytes", 800)
    running = service.get(f"/scans/{said['running']}").json()
    stored = running["summary"]["stored"] if running["summary"] else running["progress"]["done"]
    assert (running["state"], stored >= said["stored"]) == ("interrupted", True)
    waiting = dict(said.get("jobs", {"reconstruction": said["queued"]}))
    following = waiting.pop("live", None)
    for kind, job in waiting.items():
        until(lambda job=job: service.get(f"/jobs/{job}").json()["ended"], 200)
        assert (kind, service.get(f"/jobs/{job}").json()["error"]) == (kind, None)
    service.http.put(f"/scans/{said['running']}/desired-state", json={"state": "running"}).raise_for_status()
    until(lambda: service.get(f"/scans/{said['running']}").json()["state"] == "complete", 200)
    if following is not None:
        until(lambda: service.get(f"/jobs/{following}").json()["state"] == "succeeded", 200)
    service.done("/reconstructions", scan_id=said["running"], parameters={"modes": 16})


def test_newest_archive_holds_a_waiting_job_of_every_kind_with_its_form():
    """Before a release with another kind or form, leave.py adds an archive."""
    newest = max(name for name in EARLIER if name.endswith("embedded"))
    with tarfile.open(Path(__file__).parent / "data" / f"{newest}.tar.xz") as archive:
        said = json.loads(archive.extractfile("said.json").read())
        rows = archive.extractfile("rows.sql").read().decode()
    assert set(said["jobs"]) == set(JOB_TYPES)
    assert rows.count('{"form": 1, ') >= len(JOB_TYPES)


def test_a_folder_of_a_newer_version_is_refused_with_words(left):
    service, _ = left
    database = Database(metadata_url(service.settings))
    with database.write() as session:
        session.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(DamagedFile, match=r"of a newer version of Steradian.*9999"):
        database.migrate()
    assert database.revision() == "9999"
    assert "9999" not in known_revisions()
    database.close()
