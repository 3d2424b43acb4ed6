"""The object store: nothing half-written is seen, nothing foreign is taken, orphans go, copies are bounded."""

import os
import signal
import subprocess
import sys
import threading
from datetime import timedelta

import httpx
import pytest

from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound, StoreUnavailable
from steradian.core.settings import Settings
from steradian.storage import deployment_binding as belonging
from steradian.storage.blobs.cache import ContentCache
from steradian.storage.blobs.interface import result_name, scan_name, upload_name
from steradian.storage.blobs.object_store import S3BlobStore
from steradian.storage.db.database import Database
from support.seaweed import SECRET
from support.stores import keys, psycopg_url, settings_of

pytestmark = pytest.mark.long
MIB, NOW = 1 << 20, timedelta(0)
SENDER = """
import os, signal, sys, threading
from pathlib import Path
from steradian.storage.blobs import s3

class Killing:
    '''A file that ends the process once some parts of it were read.'''
    def __init__(self, path, parts):
        self.file, self.left = open(path, "rb"), parts * s3.PART_BYTES
    def read(self, count=-1):
        if self.left < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        piece = self.file.read(count)
        self.left -= len(piece)
        return piece
    def __getattr__(self, name):
        return getattr(self.file, name)

place = s3.S3Bucket(os.environ["STERADIAN_STORE"], sys.argv[2])
place._library.put(place._store, "scans/s1.h5/0123", Killing(sys.argv[1], int(sys.argv[3])), chunk_size=s3.PART_BYTES)
"""


def file_of(folder, content):
    path = folder / "file.h5"
    path.write_bytes(content)
    return path


def test_an_object_without_a_row_is_nothing_until_it_is_swept(store, objects, tmp_path):
    store.put(scan_name("s1"), file_of(tmp_path, b"A-lines"))
    assert len(keys(objects)) == 1
    assert store.stat(scan_name("s1")) is None
    with pytest.raises(NotFound):
        store.open(scan_name("s1"))
    assert store.collect_orphans() == 0, "it may wait for its row"
    assert store.collect_orphans(NOW) == 1
    assert keys(objects) == []


def test_announce_of_swept_blob_raises_store_unavailable(store, tmp_path, rows):
    stored = store.put(scan_name("s1"), file_of(tmp_path, b"A-lines"))
    store.collect_orphans(NOW)
    with pytest.raises(StoreUnavailable), rows.write() as session:
        store.commit(session, stored)
    assert store.stat(scan_name("s1")) is None


def test_overwritten_blob_leaves_previous_object_for_sweep(store, objects, tmp_path):
    for content in (b"interrupted", b"whole"):
        store.put_and_commit(scan_name("s1"), file_of(tmp_path, content))
    assert store.open(scan_name("s1")).read_bytes() == b"whole"
    assert len(keys(objects)) == 2
    assert store.collect_orphans(NOW) == 1
    assert store.audit(NOW).orphans == []
    assert store.is_whole(scan_name("s1"))


def test_another_host_gets_the_same_bytes_and_the_same_time(store, make_store, tmp_path):
    content = os.urandom(20 * MIB)
    store.put_and_commit(result_name("j1", "volume.h5"), file_of(tmp_path, content))
    other = make_store(tmp_path / "there", store)
    here, there = (each.open(result_name("j1", "volume.h5")) for each in (store, other))
    assert here.read_bytes() == there.read_bytes() == content
    assert here.stat().st_mtime_ns == there.stat().st_mtime_ns, "ETags are made of it"
    assert there.is_relative_to(tmp_path / "there")


def test_object_with_changed_bytes_is_refused_and_not_cached(store, objects, make_store, tmp_path):
    store.put_and_commit(scan_name("s1"), file_of(tmp_path, b"A-lines"))
    (key,) = keys(objects)
    objects.put(key, b"A-lineS")
    other = make_store(tmp_path / "there", store)
    with pytest.raises(DamagedFile, match="checksum"):
        other.open(scan_name("s1"))
    assert not [path for path in (tmp_path / "there" / "cache").glob("*") if path.is_file()]
    assert not store.is_whole(scan_name("s1"))
    assert store.audit().missing == []
    objects.delete(key)
    assert store.audit().missing == [scan_name("s1")]
    with pytest.raises(DamagedFile, match="any more"):
        other.open(scan_name("s1"))


def test_blob_cache_stays_within_limit_and_keeps_files_in_use(store, make_store, tmp_path):
    names = [upload_name(f"u{number}") for number in range(30)]
    for name in names:
        store.put_and_commit(name, file_of(tmp_path, os.urandom(MIB // 4)))
    other = make_store(tmp_path / "there", store, store_cache_bytes=MIB)
    held = [other.open(name) for name in names[:16]]
    assert all(path.exists() for path in held), "this process has just asked for them"
    for name in names:
        other.open(name)
    for name in reversed(names):
        assert len(other.open(name).read_bytes()) == MIB // 4
    left = [path.stat().st_size for path in (tmp_path / "there" / "cache").glob("*") if path.is_file()]
    assert len(left) <= 17, "those that are held, and the last"


def test_concurrent_opens_of_blob_share_one_cached_copy(store, make_store, tmp_path):
    store.put_and_commit(scan_name("s1"), file_of(tmp_path, os.urandom(4 * MIB)))
    other, found = make_store(tmp_path / "there", store), []
    threads = [threading.Thread(target=lambda: found.append(other.open(scan_name("s1")))) for _ in range(12)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 12
    assert len({path.stat().st_ino for path in found}) == 1


def test_a_large_copy_under_way_holds_up_no_other(tmp_path):
    """Two of one first digit: a picture is had while a volume is fetched."""
    cache, copies = ContentCache(tmp_path, MIB), []

    def fetch(draft):
        copies.append(cache.get("a2f.png", 1, 0.0, lambda picture: picture.write_bytes(b"p")))
        draft.write_bytes(b"v")

    copies.append(cache.get("a1f.h5", 1, 0.0, fetch))
    assert [copy.read_bytes() for copy in copies] == [b"p", b"v"]


def test_a_signed_address_is_readable_by_anybody_in_ranges(store, tmp_path):
    store.put_and_commit(scan_name("s1"), file_of(tmp_path, b"0123456789"))
    answer = httpx.get(store.url(scan_name("s1"), 60), headers={"Range": "bytes=2-5"}, timeout=90)
    assert (answer.status_code, answer.content) == (206, b"2345")


def test_a_scan_that_was_resumed_is_read_from_its_file_again(store, tmp_path):
    path = tmp_path / "here" / "scans" / "s1.h5"
    path.write_bytes(b"half")
    store.put_and_commit(scan_name("s1"), file_of(tmp_path, b"half"))
    os.utime(path, (1, 1))
    assert store.open(scan_name("s1")) != path
    path.write_bytes(b"more")
    os.utime(path, (2**32, 2**32))
    assert store.open(scan_name("s1")) == path


def test_a_service_does_not_start_without_the_store_that_has_its_scans(store, rows, seaweed, tmp_path):
    with_store = settings_of(tmp_path / "here", seaweed, store.place)
    belonging.bind_deployment(with_store, rows)
    assert belonging.check_binding(with_store, rows)
    for use in (belonging.bind_deployment, belonging.check_binding):
        with pytest.raises(InvalidInput, match="STERADIAN_STORE is missing"):
            use(with_store.model_copy(update={"store": None}), rows)
    store.purge()
    belonging.bind_deployment(with_store.model_copy(update={"store": None}), rows)


def test_upload_killed_midway_leaves_no_visible_object(store, objects, seaweed, tmp_path):
    path = file_of(tmp_path, os.urandom(96 * MIB))
    settings = dict(os.environ, STERADIAN_STORE=store.place, STERADIAN_DATA=str(tmp_path / "killed"))
    for part in (1, 2, 4):
        sender = subprocess.Popen([sys.executable, "-c", SENDER, str(path), seaweed.endpoint, str(part)], env=settings)
        assert sender.wait(250) == -signal.SIGKILL
        assert keys(objects) == []
        assert store.stat(scan_name("s1")) is None
    store.put_and_commit(scan_name("s1"), path)
    assert store.is_whole(scan_name("s1"))
    assert len(keys(objects)) == 1


def test_store_and_database_must_belong_together(store, seaweed, rows, postgres, tmp_path):
    assert store.check()
    other = Database(psycopg_url(postgres.database()))
    other.migrate()
    about = {"data": tmp_path, "store_endpoint": seaweed.endpoint, "database_url": "postgresql://unused"}
    ours, foreign = S3BlobStore(Settings.create(store=store.place, **about), other), seaweed.bucket()
    assert not ours.check(), "no service has bound that database"
    store.put_and_commit(scan_name("s1"), file_of(tmp_path, b"1"))
    with pytest.raises(InvalidInput, match="the store of this database"):
        ours.bind()
    elsewhere = S3BlobStore(Settings.create(store=foreign, **about), rows)
    for use in (elsewhere.check, elsewhere.bind):
        with pytest.raises(InvalidInput, match="the store of this database"):
            use()
    assert not elsewhere.is_available()
    other.close()


def test_unavailable_store_error_names_store_without_secret(rows, tmp_path, caplog):
    settings = Settings.create(
        data=tmp_path, store="s3://gone", store_endpoint="http://127.0.0.1:9", database_url="postgresql://unused"
    )
    store = S3BlobStore(settings, rows, patience=timedelta(seconds=0.1))
    with pytest.raises(StoreUnavailable) as said:
        store.put(scan_name("s1"), file_of(tmp_path, b"1"))
    assert "s3://gone" in str(said.value)
    assert SECRET not in f"{said.value} {settings!r} {caplog.text} {settings.model_dump_json()}"
