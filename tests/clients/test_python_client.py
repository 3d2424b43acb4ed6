"""The Python client against a real service."""

import matplotlib.image
import numpy as np
import pytest

from steradian_client import Client, JobFailed, ServiceError, Unreachable


@pytest.fixture
def service(url):
    with Client(url) as client:
        yield client


def test_the_whole_walk(service, tmp_path):
    """Mask, plan, scan, reconstruction, projection and volume, with progress on the way."""
    mask = service.masks.equi_steradian(aperture=13.56e-3, depth=3.6e-3, count=60)
    plan = service.plans.create(mask.id, samples=256)
    scanned, reconstructed = [], []
    scan = service.scans.wait(service.scans.create(plan.id), progress=lambda *seen: scanned.append(seen), timeout=60)
    job = service.reconstructions.create(scan.id, modes=32)
    job = service.reconstructions.wait(job, progress=lambda *seen: reconstructed.append(seen), timeout=90)
    assert scan.state == "complete"
    assert scan.simulated
    assert scanned[-1] == ("A-lines", mask.count, mask.count)
    assert reconstructed
    assert matplotlib.image.imread(service.reconstructions.save_mip(job.id, tmp_path / "mip.png")).ndim == 3
    volume = np.load(service.reconstructions.save_volume(job.id, tmp_path / "volume.npy"))
    assert volume.shape == (32, 32, 256)
    assert job.id in {made.id for made in service.reconstructions.list()}
    assert service.scans.save_file(scan.id, tmp_path / "scan.h5").read_bytes()[1:4] == b"HDF"


def test_a_repeated_request_makes_one_scan(service):
    """A request sent twice with one idempotency key, as after a lost answer, runs the plan once."""
    plan = service.plans.create(service.masks.grid(aperture=0.01, count=3, interval=1e-3).id)
    first, again = (service.scans.create(plan.id, idempotency_key="a") for _ in range(2))
    assert first.id == again.id
    assert service.scans.create(plan.id).id != service.scans.create(plan.id).id


def test_a_refusal_carries_the_services_words(service, tmp_path):
    """A wrong parameter and an unknown scan are exceptions with code, detail and request id; no file is left."""
    with pytest.raises(ServiceError, match="depth") as refused:
        service.masks.equi_steradian(aperture=0.01, depth=-1, count=60)
    assert refused.value.status == 422
    assert refused.value.request_id
    with pytest.raises(ServiceError) as missing:
        service.scans.save_file("s-none", tmp_path / "scan.h5")
    assert (missing.value.status, missing.value.code) == (404, "not-found")
    assert not list(tmp_path.iterdir())


def test_a_scan_that_is_aborted_is_a_failure_to_wait_for(service):
    """Waiting for a scan that somebody aborts raises, naming its state."""
    plan = service.plans.create(service.masks.grid(aperture=0.01, count=30, interval=3e-4).id, pulse_rate=1)
    scan = service.scans.create(plan.id)
    service.scans.abort(scan.id, "enough")
    with pytest.raises(JobFailed, match="aborted"):
        service.scans.wait(scan, timeout=60)


def test_no_service_is_said_so():
    """An address where nothing answers is an Unreachable, which names it."""
    with Client("http://127.0.0.1:9") as client, pytest.raises(Unreachable, match=r"127\.0\.0\.1:9"):
        client.masks.list()
