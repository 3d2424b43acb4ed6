"""What was there a moment ago: files deleted while they are read, a data folder and a database that are away."""

import errno
import json
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from steradian.api.app import create_app
from steradian.api.background.peers import PeerRegistry
from steradian.api.background.retention import apply_retention
from steradian.api.http import array_response as arrays
from steradian.api.http.file_response import RangeFileResponse
from steradian.api.routers import masks, scan_data
from steradian.core.exceptions import DamagedFile
from steradian.core.settings import Settings
from steradian.imaging import Volume, VoxelAxes
from steradian.reconstructions.volumes.file import write_volume
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.storage.blobs.interface import FolderBlobStore
from steradian.storage.blobs.object_store import FACT_KEY, S3BlobStore
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.repositories.plans import PlanRepository
from support.alines import Aline
from support.damage import BITS, spoil
from support.stores import settings_of

from .test_races import Bench, ask

REVISION = {
    "number": 1, "points": 9, "planned": 9, "final": True, "coverage": {}, "quality": {}, "seconds": {},
    "image": {"shape": [4, 4, 4], "spacing": [1e-4, 1e-4, 1e-4], "axes": ["x", "y", "z"], "origin": [0, 0, 0]},
}  # fmt: skip


class Whole(Bench):
    """One whose scans and images have files that can be read."""

    def scan(self):
        scan = super().scan()
        path, plan = self.services.data.scan_file(scan), self.services.scans.get(scan).plan_id
        path.unlink()
        whole = PlanRepository(self.services.database).load(plan)
        create_scan_file(path, whole, scan_id=scan)
        with ScanFileWriter(path) as store:
            store.append(Aline(point, np.ones(whole.samples, np.int16)) for point in range(whole.mask.count))
        return scan

    def image(self):
        image, axis = super().image(), np.arange(4) * 1e-4
        folder = self.services.data.job(image)
        folder.volume.unlink()
        volume = Volume(np.ones((4, 4, 4), np.float32), VoxelAxes(axis, axis, axis), (1e-4,) * 3)
        write_volume(folder.volume, volume, parameters={}, provenance={})
        (folder.root / "mip-z.png").write_bytes(b"picture")
        (folder.root / "revision.json").write_text(json.dumps(REVISION))
        folder.log.write_text("made\n")
        return image


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    bench = Whole(tmp_path_factory.mktemp("gone"), None)
    yield bench
    bench.services.close()


def picture(bench):
    mask = bench.mask()
    path = bench.services.data.picture(mask)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"picture")
    return mask


FILES = [
    (Whole.scan, "/scans/{}/file"),
    (Whole.scan, "/scans/{}/shots"),
    (Whole.scan, "/scans/{}/coverage"),
    (Whole.scan, "/scans/{}/alines"),
    (Whole.scan, "/scans/{}/alines/latest"),
    (Whole.image, "/reconstructions/{}/mip"),
    (Whole.image, "/reconstructions/{}/revision"),
    (Whole.image, "/reconstructions/{}/volume"),
    (Whole.image, "/reconstructions/{}/volume.ome.zarr/zarr.json"),
]


@pytest.mark.parametrize(("make", "path"), FILES)
def test_get_file_deleted_after_open_returns_404(bench, monkeypatch, make, path):
    other, identifier, find = make(bench), make(bench), FolderBlobStore.open

    def delete(folder, name):
        found = find(folder, name)
        found.unlink()
        return found

    assert bench.ask("GET", path.format(other)).status_code == 200
    monkeypatch.setattr(FolderBlobStore, "open", delete)
    answer = bench.ask("GET", path.format(identifier))
    assert (answer.status_code, answer.json()["code"]) == (404, "not-found")


def test_a_large_volume_that_is_deleted_before_its_first_value_is_read_is_not_there(bench, monkeypatch):
    image, header = bench.image(), arrays._npy_header

    def delete(*about):
        bench.services.data.job(image).volume.unlink()
        return header(*about)

    monkeypatch.setattr(arrays, "CHUNK_BYTES", 1)
    monkeypatch.setattr(arrays, "_npy_header", delete)
    answer = bench.ask("GET", f"/reconstructions/{image}/volume", headers={"Accept": arrays.NPY})
    assert (answer.status_code, answer.json()["code"]) == (404, "not-found")


def test_a_log_that_moves_into_the_store_while_it_is_asked_for_is_shown(bench, monkeypatch):
    job, find = bench.image(), FolderBlobStore.open
    here = bench.services.data.job(job).log
    there = here.with_name("log-0001.txt")

    def move(folder, name):
        if here.exists():
            here.rename(there)
        return find(folder, name)

    monkeypatch.setattr(FolderBlobStore, "open", move)
    answer = bench.ask("GET", f"/jobs/{job}/log")
    assert (answer.status_code, answer.text) == (200, "made\n")


class GoneBefore(RangeFileResponse):
    def __init__(self, path, **more):
        path.unlink()
        super().__init__(path, **more)


class GoneMeanwhile(RangeFileResponse):
    def set_stat_headers(self, stat_result):
        super().set_stat_headers(stat_result)
        self.path.unlink()


@pytest.mark.parametrize("deleted", [GoneBefore, GoneMeanwhile])
@pytest.mark.parametrize("headers", [{}, {"Range": "bytes=1-2"}, {"Want-Repr-Digest": "sha-256=1"}])
@pytest.mark.parametrize(
    ("module", "make", "path"), [(scan_data, Whole.scan, "/scans/{}/file"), (masks, picture, "/masks/{}/picture")]
)
def test_a_file_that_is_deleted_before_its_first_byte_is_sent_is_not_there(
    bench, monkeypatch, module, make, path, headers, deleted
):
    monkeypatch.setattr(module, "RangeFileResponse", deleted)
    answer = bench.ask("GET", path.format(make(bench)), headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (404, "not-found")


@pytest.mark.parametrize("path", ["shots", "coverage", "alines/latest"])
@pytest.mark.parametrize("bit", BITS)
def test_a_scan_with_a_damaged_header_is_a_damaged_file(bench, path, bit):
    scan = bench.scan()
    spoil(bench.services.data.scan_file(scan), "alines/status", bit)
    answer = bench.ask("GET", f"/scans/{scan}/{path}")
    assert (answer.status_code, answer.json()["code"]) == (422, "damaged-file")


def test_alines_and_volumes_with_damaged_headers_are_damaged_files(bench):
    image = bench.image()
    scan = bench.services.ledger.reconstruction(image).scan_id
    spoil(bench.services.data.scan_file(scan), "alines/samples")
    spoil(bench.services.data.job(image).volume, "values")
    for path in (f"/scans/{scan}/alines", f"/reconstructions/{image}/volume", f"/reconstructions/{image}/mip?axis=x"):
        answer = bench.ask("GET", path, headers={"Accept": "application/octet-stream"})
        assert (answer.status_code, answer.json()["code"]) == (422, "damaged-file"), path


def gone(bench, monkeypatch, tmp_path):
    """Nothing is there any more."""


def stale(bench, monkeypatch, tmp_path):
    """It is on another host, where it was replaced."""

    def refusing(call):
        def refused(path=".", *more, **named):
            if str(path).startswith(str(tmp_path / "data")):
                raise OSError(errno.ESTALE, os.strerror(errno.ESTALE), str(path))
            return call(path, *more, **named)

        return refused

    for name in ("stat", "statvfs", "scandir", "listdir"):
        monkeypatch.setattr(os, name, refusing(getattr(os, name)))


@pytest.fixture(params=[gone, stale])
def away(bench, monkeypatch, tmp_path, request):
    """A service whose data folder is away; its database is elsewhere."""
    data = DataDirectory(tmp_path / "data")
    for name, value in {
        "data": data,
        "disk": replace(bench.services.disk, folder=data.root),
        "arrays": FolderBlobStore(data),
    }.items():
        monkeypatch.setattr(bench.services, name, value)
    request.param(bench, monkeypatch, tmp_path)
    return bench


def test_a_data_folder_that_is_away_makes_the_service_unready(away):
    answer = away.ask("GET", "http://127.0.0.1/readyz")
    assert answer.status_code == 503
    checks = answer.json()["checks"]
    assert (checks["database"], checks["store"], checks["disk"]) == (True, False, False)


def test_metrics_without_data_folder_returns_remaining_figures(away):
    answer = away.ask("GET", "http://127.0.0.1/metrics")
    assert answer.status_code == 200
    assert "steradian_events_last" in answer.text
    assert "steradian_disk_free_bytes" not in answer.text


def test_storage_without_data_folder_returns_503(away):
    answer = away.ask("GET", "/storage")
    assert (answer.status_code, answer.json()["code"]) == (503, "store-unavailable")
    assert "data folder" in answer.json()["detail"]


def test_readiness_with_store_and_database_unreachable_returns_503(tmp_path):
    pytest.importorskip("obstore")
    settings = settings_of(tmp_path, SimpleNamespace(endpoint="http://127.0.0.1:1"), "s3://bucket/place")
    app = create_app(settings.model_copy(update={"database_url": "postgresql://127.0.0.1:1/none"}))
    answer = ask(app, "GET", "http://127.0.0.1/readyz")
    app.state.services.close()
    assert answer.status_code == 503
    checks = answer.json()["checks"]
    assert (checks["database"], checks["store"]) == (False, False)


def test_s3_store_identity_lost_during_check_is_unavailable(bench, tmp_path):
    class Forgetful:
        def size(self, key):
            return 32

        def range(self, key, first, count):
            raise DamagedFile("the store does not have identity any more")

    pytest.importorskip("obstore")
    settings = settings_of(tmp_path, SimpleNamespace(endpoint="http://127.0.0.1:1"), "s3://bucket/place")
    database = bench.services.database
    with database.write() as session:
        database.set_fact(session, FACT_KEY, "known")
    store = S3BlobStore(settings, database)
    store._at_once = Forgetful()
    assert not store.is_available()


def test_retention_file_vanishing_during_cleanup_removes_other_files(bench, monkeypatch):
    glob, folder = Path.glob, bench.services.data.references
    first, second = folder / "a.new", folder / "b"
    for path in (first, second):
        path.write_bytes(b"image")
        os.utime(path, (0, 0))

    def renamed(path, pattern):
        found = sorted(glob(path, pattern))
        first.unlink(missing_ok=True)
        return iter(found)

    monkeypatch.setattr(Path, "glob", renamed)
    apply_retention(bench.services)
    assert not second.exists()


def test_retention_removes_stale_partial_uploads_on_each_node(bench):
    old, new = (bench.services.data.uploads / f"{name}.part" for name in ("u1", "u2"))
    for path in (old, new):
        path.write_bytes(b"half of it")
    os.utime(old, (0, 0))
    apply_retention(bench.services, shared=False)
    assert (old.exists(), new.exists()) == (False, True)


def test_peer_registry_scanner_retired_during_lookup_is_not_followed(tmp_path):
    class Retired(dict):
        def __contains__(self, scanner_id):
            nodes._rows = {}
            return True

    nodes = PeerRegistry(Settings.create(data=tmp_path, role="api", database_url="postgresql://unused"), None)
    nodes._rows = Retired({"scanner-1": SimpleNamespace(follows=True)})
    nodes.follows("scanner-1")  # either answer is right
    assert not nodes.follows("scanner-1")
