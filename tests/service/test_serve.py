"""``steradian serve`` as a person meets it: real processes, a real port, a real data directory."""

import io
import os
import signal
import subprocess
import sys

import h5py
import httpx
import matplotlib.image
import numpy as np
import pytest

from support.processes import are_gone, runs, tree_of
from support.services import EQUI, WAIT, Service
from support.waiting import until

MAIN = [sys.executable, "-c", "from steradian.cli import main; main()"]


class Simulated(Service):
    """As a person starts it: what it is told stands behind the command."""

    def __init__(self, folder):
        self.command = [*MAIN, "serve", "--port", "0", "--data", str(folder)]
        super().__init__(folder)

    def read(self, path):
        return self.get(path).json()


@pytest.fixture
def start(tmp_path):
    """Starts the service on one data directory; whatever the test leaves running is killed."""
    started = []

    def start():
        started.append(Simulated(tmp_path))
        assert "simulated scanner" in started[-1].start().said
        return started[-1]

    yield start
    for service in started:
        service.close()


def answers(service):
    try:
        return service.http.get("/").status_code == 200
    except httpx.TransportError:
        return False


@pytest.mark.long
@pytest.mark.timeout(300)  # the first reconstruction on a machine compiles its kernels
def test_the_whole_walk_an_end_and_a_second_start(tmp_path, start):
    service = start()

    # The walk: mask, plan, scan, reconstruction, projection, without polling.
    mask = service.make("/masks", **EQUI)
    plan = service.make("/plans", mask_id=mask["id"], samples=256)
    scan = service.make("/scans", plan_id=plan["id"])
    assert (scan["state"], scan["simulated"]) == ("complete", True)
    assert scan["summary"] == {"points": 53, "stored": 53, "fired": 53}
    reconstruction = service.make("/reconstructions", scan_id=scan["id"], parameters={"modes": 32})
    assert (reconstruction["state"], reconstruction["error"]) == ("succeeded", None)
    assert reconstruction["report"]["provenance"]["mask_id"] == mask["id"]
    here = f"/reconstructions/{reconstruction['id']}"
    for axis in "xyz":
        picture = service.http.get(f"{here}/mip?axis={axis}")
        assert picture.headers["content-type"] == "image/png"
        assert matplotlib.image.imread(io.BytesIO(picture.content)).ndim == 3
    values = np.load(io.BytesIO(service.http.get(f"{here}/volume").content))
    assert (values.shape, values.dtype) == ((32, 32, 256), np.float32)
    assert values.any()
    file = service.http.get(f"/scans/{scan['id']}/file")
    with h5py.File(io.BytesIO(file.content), "r") as content:
        assert content["alines/samples"].shape == (53, 256)
    part = service.http.get(f"/scans/{scan['id']}/file", headers={"Range": "bytes=0-7"})
    assert (part.status_code, part.content) == (206, b"\x89HDF\r\n\x1a\n")

    # A second service on the same directory is refused in one clear line.
    second = subprocess.run([*MAIN, "serve", "--port", "0", "--data", str(tmp_path)], capture_output=True, text=True)
    assert second.returncode == 4
    assert f"in use by process {service.process.pid}" in second.stderr
    assert "Traceback" not in second.stderr

    # Ctrl-C in the middle of a scan and with a job queued: every process ends, nothing is lost.
    slow = service.make("/plans", mask_id=mask["id"], samples=256, pulse_rate=1, averages=10)
    running = service.http.post("/scans", json={"plan_id": slow["id"]}, headers={"Idempotency-Key": "slow"}).json()
    until(lambda: service.read(f"/scans/{running['id']}")["state"] == "running")
    queued = service.http.post("/reconstructions", json={"scan_id": scan["id"], "parameters": {"modes": 24}})
    assert queued.status_code == 202
    processes = tree_of(service.process.pid)
    assert len(processes) >= 4, "API, acquisition, simulator, worker"
    assert service.end(signal.SIGINT) == 0
    until(lambda: are_gone(processes))
    said = service.log.read_text()

    # The second start.
    service = start()
    for kind, made in {"masks": mask, "plans": plan, "scans": scan, "reconstructions": reconstruction}.items():
        assert made in service.read(f"/{kind}")["items"]
    done = service.http.get(f"/reconstructions/{queued.json()['id']}", headers=WAIT).json()
    assert done["state"] == "succeeded"
    assert done["attempt"] == 1 or "did not end in time and is killed" in said, (done, said)
    assert service.read(f"/scans/{running['id']}")["state"] == "interrupted", "the laser never starts by itself"
    service.http.put(f"/scans/{running['id']}/desired-state", json={"state": "stopped"}).raise_for_status()
    until(lambda: service.read(f"/scans/{running['id']}")["state"] == "partial")
    assert service.read(f"/scans/{running['id']}")["summary"]["stored"] > 0
    until(lambda: httpx.get(f"{service.url}/readyz", timeout=250).status_code == 200)

    # A child that is killed is started again; a killed supervisor takes every process with it.
    processes = tree_of(service.process.pid)
    api = next(pid for pid in processes if runs(pid, "steradian.api"))
    os.kill(api, signal.SIGKILL)
    until(lambda: api not in tree_of(service.process.pid))
    until(lambda: answers(service))
    assert service.read("/scans")["items"]
    processes = tree_of(service.process.pid)
    assert service.end(signal.SIGKILL) == -signal.SIGKILL
    until(lambda: are_gone(processes))


@pytest.mark.long
def test_a_port_in_use_is_named(tmp_path):
    import socket

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        result = subprocess.run(
            [*MAIN, "serve", "--port", port, "--data", str(tmp_path)], capture_output=True, text=True
        )
    assert result.returncode == 2
    assert f"127.0.0.1:{port}" in result.stderr
    assert "Traceback" not in result.stderr
