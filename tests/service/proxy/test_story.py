"""From a mask to a projection through nginx as documented, with TLS below a path, by curl and the Python client."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from PIL import Image

from steradian_client import Client
from support.nginx import Laboratory, needed
from support.services import Service

from .conftest import BEARER, KEY

PAGE = Path(__file__).parents[3] / "clients" / "http" / "README.md"
FEWER = {'"count": 1600': '"count": 160', '"depth_range"': '"modes": 32, "depth_range"'}
pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]


def block(at, **replaced):
    """Return the page's requests for another address."""
    (found,) = [part for part in re.findall(r"```sh\n(.*?)```", PAGE.read_text(), re.DOTALL) if "api/v1" in part]
    for old, new in {"http://127.0.0.1:8000": at, **replaced}.items():
        assert old in found, old
        found = found.replace(old, new)
    return found


def run(script, folder, laboratory):
    """Run it with a key and the certificate, as a person writes them into curl's configuration."""
    folder.mkdir(exist_ok=True)
    (folder / ".curlrc").write_text(f'header = "Authorization: Bearer {KEY}"\ncacert = "{laboratory.certificate}"\n')
    how = {"cwd": folder, "env": os.environ | {"HOME": str(folder)}, "capture_output": True, "text": True}
    return subprocess.run(["bash", "-c", script], timeout=500, **how)


@pytest.mark.skipif(shutil.which("curl") is None, reason="needs curl: apt-get install curl")
def test_the_pages_requests_work_below_a_path_with_tls_and_may_be_sent_again(laboratory, service, tmp_path):
    for _ in range(2):
        ran = run(block(laboratory.url, **FEWER), tmp_path, laboratory)
        assert ran.returncode == 0, ran.stdout + ran.stderr
        with Image.open(tmp_path / "mip-z.png") as picture:
            assert picture.format == "PNG"
        (tmp_path / "mip-z.png").unlink()
        assert len(service.get("/scans").json()["items"]) == len(service.get("/reconstructions").json()["items"]) == 1


def test_the_pages_requests_begin_no_second_scan_after_a_proxys_504(tmp_path):
    """A proxy gives up before the answer; the scan goes on, and the same requests again are answered with it."""
    needed()
    service = Service(tmp_path / "data", log=tmp_path / "log", api_key=KEY, require_key=True, simulator_speed=1).start()
    service.http.headers.update(BEARER)
    hasty = Laboratory(tmp_path / "hasty", service.url, **{"proxy_read_timeout 60s": "proxy_read_timeout 2s"})
    patient = Laboratory(tmp_path / "patient", service.url)
    run(block(hasty.url, **FEWER | {'"pulse_rate": 50': '"pulse_rate": 20'}), tmp_path / "home", hasty)
    assert 504 in hasty.nginx.statuses
    assert len(service.get("/scans").json()["items"]) == 1
    ran = run(block(patient.url, **FEWER | {'"pulse_rate": 50': '"pulse_rate": 20'}), tmp_path / "home", patient)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    (scan,) = service.get("/scans").json()["items"]
    assert scan["state"] == "complete"
    with Image.open(tmp_path / "home" / "mip-z.png") as picture:
        assert picture.format == "PNG"
    for one in (hasty, patient, service):
        one.close()


def test_the_python_client_works_below_a_path_with_tls(laboratory, tmp_path, monkeypatch):
    """Mask, plan, scan with progress, reconstruction, volume, projection, a download and an upload."""
    monkeypatch.setenv("SSL_CERT_FILE", str(laboratory.certificate))
    seen = []
    with Client(laboratory.url, key=KEY) as client:
        mask = client.masks.create(arrangement="equi-steradian", aperture=13.56e-3, depth=3.6e-3, count=60)
        plan = client.plans.create(mask.id, samples=256)
        scan = client.scans.wait(client.scans.create(plan.id), progress=lambda *told: seen.append(told))
        assert scan.state == "complete"
        assert seen
        job = client.reconstructions.wait(client.reconstructions.create(scan.id, modes=32))
        volume = client.reconstructions.volume(job.id)
        assert volume.values.shape[:2] == (32, 32)
        client.reconstructions.download_mip(job.id, tmp_path / "mip.png")
        with Image.open(tmp_path / "mip.png") as picture:
            assert picture.format == "PNG"
        path = client.scans.save_file(scan.id, tmp_path / "scan.h5")
        assert client.uploads.create(path).bytes == path.stat().st_size
        assert len(client.masks.list()) >= 1
