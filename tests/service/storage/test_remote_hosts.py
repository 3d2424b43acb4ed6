"""A service and a worker on another host: a database and an object store are all that they share."""

import contextlib
import io
import signal
import subprocess
import sys
from datetime import timedelta

import numpy as np
import pytest

from steradian.core.settings import Settings
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_scan
from steradian.reconstructions.volumes.file import read_volume
from steradian.storage.blobs.object_store import S3BlobStore
from steradian.storage.db.database import Database, metadata_url
from support import warmed
from support.seaweed import SECRET
from support.services import WAIT, Service
from support.waiting import until

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]
PARAMETERS = {"modes": 24}


class Hosts:
    """One with the scanner and the API, one with a worker."""

    def __init__(self, here, there, **shared):
        self.here, self.there, self.shared = here, there, shared
        self.service = Service(here, workers=0, simulator_speed=20.0, **shared)
        self.worker = None

    def start(self):
        self.service.start()
        settings = Settings.create(data=self.there, **self.shared)
        with (self.there / "worker.log").open("ab") as log:
            self.worker = warmed.start(
                [sys.executable, "-m", "steradian", "worker", "--name", "far"],
                env=settings.environment(),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        return self

    def stop(self):
        if self.worker is not None:
            self.worker.send_signal(signal.SIGTERM)
            self.worker.wait(250)
        self.service.close()

    @contextlib.contextmanager
    def store(self):
        """What a third host with the same keys would see."""
        settings = Settings.create(data=self.here, **self.shared)
        database = Database(metadata_url(settings))
        try:
            yield S3BlobStore(settings, database)
        finally:
            database.close()

    def run(self, *words, code=0):
        """Run a command on the first host."""
        done = warmed.run([sys.executable, "-m", "steradian", *words], env=self.service.settings.environment())
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout + done.stderr

    def volume(self, image):
        return self.service.get(f"/reconstructions/{image['id']}/volume").content


@pytest.fixture(scope="module")
def hosts(tmp_path_factory, postgres, seaweed):
    here, there = tmp_path_factory.mktemp("here"), tmp_path_factory.mktemp("there")
    shared = {"database_url": postgres.database(), "store": seaweed.bucket(), "store_endpoint": seaweed.endpoint}
    hosts = Hosts(here, there, **shared)
    try:
        yield hosts.start()
    finally:
        hosts.stop()


@pytest.fixture(scope="module")
def scan(hosts):
    return hosts.service.make("/scans", plan_id=hosts.service.plan())


@pytest.fixture(scope="module")
def image(hosts, scan):
    return hosts.service.done("/reconstructions", scan_id=scan["id"], parameters=PARAMETERS)


def test_remote_worker_reconstructs_scan_as_local_one(hosts, scan, image, tmp_path):
    path = tmp_path / "scan.h5"
    path.write_bytes(hosts.service.get(f"/scans/{scan['id']}/file").content)
    reconstruct_scan(path, tmp_path / "ours", ReconstructionParameters.create(**PARAMETERS))
    ours = read_volume(tmp_path / "ours" / "volume.h5").values
    theirs = np.load(io.BytesIO(hosts.volume(image)))
    np.testing.assert_allclose(theirs, ours, rtol=1e-5, atol=1e-6 * np.abs(ours).max())
    assert hosts.service.get(f"/reconstructions/{image['id']}/mip").content.startswith(b"\x89PNG")
    assert hosts.service.get(f"/reconstructions/{image['id']}/volume.ome.zarr/0/zarr.json").content
    assert hosts.service.get("/jobs/" + image["id"] + "/log").status_code == 200
    until(lambda: not list((hosts.there / "jobs").iterdir()), tell=lambda: "the worker's folder is not tidy")
    assert not list((hosts.here / "jobs").iterdir()), "nothing was shared but the store"
    assert not list((hosts.there / "scans").iterdir())


def test_a_scan_travels_through_upload_and_store_and_back(hosts, scan):
    service = hosts.service
    sent = service.done("/jobs", kind="export", scan_id=scan["id"], format="ipasc")
    file = service.get(f"{sent['links']['self']}/files/{sent['files'][0]}").content
    upload = service.http.post("/uploads", content=file).json()
    taken = service.done("/jobs", kind="import", upload_id=upload["id"])
    assert taken["result"]["stored"] == taken["result"]["points"] > 0
    assert service.http.get(f"/uploads/{upload['id']}").status_code == 404
    again = service.done("/reconstructions", scan_id=taken["result"]["scan_id"], parameters=PARAMETERS)
    first = service.done("/reconstructions", scan_id=scan["id"], parameters=PARAMETERS)
    quality = service.done("/jobs", kind="quality", reconstruction_id=again["id"], reference_id=first["id"])
    assert quality["result"]["figures"]["volume_correlation"] > 0.999


def test_a_scan_that_is_followed_from_elsewhere_ends_as_its_full_reconstruction(hosts):
    service = hosts.service
    scan = service.start_scan(service.plan())
    left = hosts.there / "scans" / f"{scan['id']}.h5"
    left.parent.mkdir(exist_ok=True)
    left.symlink_to(hosts.there / "cache" / "gone")  # by a job that was killed, of a copy that made room for others
    live = service.done("/reconstructions", scan_id=scan["id"], follow=True, parameters=PARAMETERS)
    left.unlink()
    whole = service.done("/reconstructions", scan_id=scan["id"], parameters=PARAMETERS)
    assert hosts.volume(live) == hosts.volume(whole)


def test_deleted_reconstruction_is_removed_from_store(hosts, scan):
    image = hosts.service.done("/reconstructions", scan_id=scan["id"], parameters=PARAMETERS)
    with hosts.store() as store:
        assert list(store.list_names(f"jobs/{image['id']}/"))
        hosts.service.http.delete(f"/reconstructions/{image['id']}").raise_for_status()
        until(lambda: not list(store.list_names(f"jobs/{image['id']}/")))
        assert store.audit(timedelta(0)).orphans == []


def test_a_store_that_is_killed_for_a_while_costs_nothing_but_time(hosts, scan, image, seaweed):
    service = hosts.service
    file = service.get(f"/scans/{scan['id']}/file").content
    seaweed.stop()
    try:
        asked = service.http.post("/reconstructions", json={"scan_id": scan["id"], "parameters": PARAMETERS}).json()
        ready = service.http.get(f"{service.url}/readyz")
        assert (ready.status_code, ready.json()["checks"]["store"]) == (503, False)
        assert service.get(f"/scans/{scan['id']}/file").content == file, "it was read here before"
        refused = service.http.post("/uploads", content=b"a file")
        assert (refused.status_code, refused.json()["code"]) == (503, "store-unavailable")
        until(lambda: service.get(f"/reconstructions/{asked['id']}").json()["attempt"] >= 1)
    finally:
        seaweed.start()
    done = asked
    while done["state"] in {"queued", "running"}:
        done = service.get(f"/reconstructions/{asked['id']}", headers=WAIT).json()
    assert done["state"] == "succeeded", done["error"]
    assert hosts.volume(done) == hosts.volume(image)
    with hosts.store() as store:
        assert store.audit(timedelta(0)).missing == []


def test_no_log_and_no_answer_holds_the_store_s_key(hosts, image):
    said = [path.read_text() for path in (hosts.service.log, hosts.there / "worker.log")]
    said += [
        hosts.service.get(path).text for path in ("/", f"/jobs/{image['id']}/log", f"/reconstructions/{image['id']}")
    ]
    assert all(SECRET not in text for text in said)


def test_storage_moves_from_store_to_folder_and_back_unchanged(hosts, scan, image):
    """The last test: the service is ended and started with and without the store."""
    paths = f"/reconstructions/{image['id']}/volume", f"/scans/{scan['id']}/file", f"/jobs/{image['id']}/log"
    before = [hosts.service.get(path).content for path in paths]
    hosts.stop()
    with hosts.store() as store:
        logs = [name for name in store.list_names("jobs/") if "/log" in name]
    assert "objects" in hosts.run("storage", "check", "--contents")
    refused = hosts.run("backup", str(hosts.there / "backup"), code=4)
    assert "storage move folder" in refused
    hosts.run("storage", "move", "folder")
    assert (hosts.here / "jobs" / image["id"] / "volume.h5").is_file()
    local = Service(hosts.here, workers=0, database_url=hosts.shared["database_url"]).start()
    try:
        assert [local.get(path).content for path in paths] == before
    finally:
        local.close()
    hosts.run("storage", "move", "store")
    assert not list((hosts.here / "jobs").iterdir())
    hosts.start()
    assert [hosts.service.get(path).content for path in paths] == before
    with hosts.store() as store:
        assert [name for name in store.list_names("jobs/") if "/log" in name] == logs != []
        assert (store.audit(timedelta(0)).missing, store.audit(timedelta(0)).orphans) == ([], [])
    assert hosts.service.get(f"/reconstructions/{image['id']}", headers=WAIT).json()["state"] == "succeeded"
