"""What breaks between the Python client and a real service: nothing is lost and nothing happens twice."""

import hashlib
import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from steradian_client import Client, ConnectionFailed, CorruptTransfer, JobFailed
from support.flaky import Flaky

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def service(url):
    with Client(url) as client:
        yield client


@pytest.fixture
def line(url):
    proxy = Flaky(url)
    yield proxy
    proxy.close()


@pytest.fixture
def shaky(line):
    """A client over a line that breaks."""
    with Client(line.url) as client:
        client.health()
        yield client


def slow_plan(client, pulse_rate=1):
    mask = client.masks.equi_steradian(aperture=13.56e-3, depth=3.6e-3, count=60)
    return client.plans.create(mask.id, samples=256, pulse_rate=pulse_rate)


def long_plan(client):
    """A plan that takes longer than any test: 900 points at 1 Hz, twenty times faster than real."""
    return client.plans.create(client.masks.grid(aperture=0.01, count=30, interval=3e-4).id, pulse_rate=1)


@pytest.fixture(scope="module")
def recorded(service):
    """A scan with 4 MB of A-lines."""
    along = np.arange(32) * 1e-4
    positions = np.stack(np.meshgrid(along, along, indexing="ij"), -1).reshape(-1, 2)
    traces = np.random.default_rng(1).normal(size=(1024, 1024)).astype(np.float32)
    return service.imports.import_arrays(traces, positions, sampling_interval=16e-9, sound_speed=1500.0, timeout=250)


def test_a_download_that_is_cut_in_half_is_taken_up_there(service, shaky, line, recorded, tmp_path):
    """The file is the same byte by byte, and its first half is not fetched again."""
    whole = service.scans.save_file(recorded.id, tmp_path / "whole.h5").read_bytes()
    line.cut_after(len(whole) // 2)
    said = []
    found = shaky.scans.save_file(recorded.id, tmp_path / "cut.h5", progress=lambda *seen: said.append(seen))
    assert hashlib.sha256(found.read_bytes()).digest() == hashlib.sha256(whole).digest()
    assert line.connections == 2, "one connection was cut"
    assert said[-1] == (len(whole), len(whole))
    assert [done for done, _ in said] == sorted(done for done, _ in said), "it did not begin anew"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cut.h5", "whole.h5"]


def test_a_download_that_is_changed_on_its_way_is_refused(shaky, line, recorded, tmp_path):
    """The service states the checksum of the whole file; what does not have it is not left behind."""
    line.spoil_after(1_000_000)
    with pytest.raises(CorruptTransfer, match="SHA-256"):
        shaky.scans.save_file(recorded.id, tmp_path / "scan.h5")
    assert not list(tmp_path.iterdir())


def test_an_upload_that_is_cut_off_is_sent_again(shaky, line, service, tmp_path):
    """What arrives has the file's checksum, which the client compares."""
    (tmp_path / "data.bin").write_bytes(np.random.default_rng(2).bytes(3_000_000))
    line.lose_answer(b"POST /api/v1/uploads")
    upload = shaky.uploads.create(tmp_path / "data.bin")
    assert line.lost
    assert upload.sha256 == hashlib.sha256((tmp_path / "data.bin").read_bytes()).hexdigest()
    service.uploads.delete(upload)


def test_client_retry_after_lost_response_applies_request_once(service, shaky, line):
    """A scan queued over a line that loses the answer is queued once, as its key says; a deletion is done."""
    plan = slow_plan(service, 50)
    before = {scan.id for scan in service.scans.list()}
    line.lose_answer(b"POST /api/v1/scans")
    scan = shaky.scans.create(plan.id)
    assert line.lost
    assert {scan.id for scan in service.scans.list()} - before == {scan.id}
    service.scans.wait(scan, timeout=250)
    line.lose_answer(b"DELETE /api/v1/scans")
    shaky.scans.delete(scan)
    assert len(line.lost) == 2
    assert {scan.id for scan in service.scans.list()} == before


def test_laser_firing_request_with_lost_response_is_not_retried(service, shaky, line):
    """Somebody may have stopped the scan since: the client says that it does not know, and fires no more."""
    scan = service.scans.create(long_plan(service).id)
    assert any(event.kind == "progress" for event in service.events.follow(scan_id=scan.id))
    service.scans.pause(scan.id)
    line.lose_answer(b"PUT /api/v1/scans")
    with pytest.raises(ConnectionFailed, match="look before you repeat it"):
        shaky.scans.resume(scan.id)
    assert len(line.lost) == 1
    service.scans.abort(scan.id)
    service.scanners.emergency_stop()
    line.lose_answer(b"DELETE /api/v1/scanners")
    with pytest.raises(ConnectionFailed, match="look before you repeat it"):
        shaky.scanners.release_emergency_stop()
    service.scanners.release_emergency_stop()


class Rogue(BaseHTTPRequestHandler):
    """A service that says of every job that it is over and left a file of a bold name."""

    def do_GET(self):
        about = dict.fromkeys(("error", "created", "started", "ended", "result"))
        about |= {"id": "j0", "state": "succeeded", "kind": "export", "asked": {}, "priority": 0, "attempt": 1}
        about |= {"progress": {"stage": None, "done": 0, "total": 0}, "files": ["../outside"]}
        body = b"bytes" if "/files/" in self.path else json.dumps(about).encode()
        self.rfile.read(int(self.headers.get("Content-Length", 0)))
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    do_POST = do_GET  # noqa: N815 - http.server's name


def test_files_of_a_job_lie_in_the_folder_that_was_asked_for(tmp_path):
    """Which is made if need be, and whatever the service calls them."""
    with ThreadingHTTPServer(("127.0.0.1", 0), Rogue) as server, ThreadPoolExecutor(1) as pool:
        pool.submit(server.serve_forever)
        try:
            with Client(f"http://127.0.0.1:{server.server_port}") as client:
                found = client.exports.export_and_download("nrrd", tmp_path / "folder", reconstruction_id="r0")
        finally:
            server.shutdown()
    assert found == [tmp_path / "folder" / "outside"]
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["outside"]


@pytest.mark.timeout(60)  # where it is kept for later, that is not over
def test_laser_firing_request_while_disconnected_is_not_queued(line):
    """Somebody may stop the scan before a service that is away is back: the order is dropped, not sent then."""
    with Client(line.url, patience=1e6) as client:
        client.health()
        line.close()
        with pytest.raises(ConnectionFailed):
            client.scans.resume("scan")
        with pytest.raises(ConnectionFailed):
            client.scanners.release_emergency_stop()


def test_an_event_stream_that_is_reset_goes_on_where_it_broke(service, shaky, line):
    """Each change of state comes once, in order, over three breaks; the wait sees every A-line counted."""
    scan = service.scans.create(slow_plan(service).id)
    begun = next(itertools.islice(service.events.follow(), 1)).id
    counts, breaks = [], []

    def count(stage, done, total):
        counts.append(done)
        if len(breaks) < 3 and done >= 10 * (len(breaks) + 1):
            breaks.append(done)
            line.reset()

    with ThreadPoolExecutor(1) as pool, Client(line.url) as other:
        waited = pool.submit(shaky.scans.wait, scan, progress=count, timeout=250)
        states = []
        for event in other.events.follow(scan_id=scan.id, last_event_id=begun):
            if event.kind == "scan" and "state" in event.data:
                states.append(event.data["state"])
            if states[-1:] == ["complete"]:
                break
        assert waited.result(100).state == "complete"
    assert len(breaks) == 3
    assert states == [change["state"] for change in service.scans.get(scan.id).history][-len(states) :]
    assert len(states) == len(set(states)) >= 2
    assert counts == sorted(counts)
    assert counts[-1] == service.scans.coverage(scan.id).points


@pytest.mark.parametrize("another_listens", [False, True])
def test_event_stream_late_subscriber_gets_no_past_progress(service, another_listens):
    """Progress is what is being done now, not what was when somebody last listened, or a moment ago for another."""
    scan = service.scans.create(long_plan(service).id)
    following = service.events.follow(kind="scan")
    assert any(event.kind == "progress" and event.subject == scan.id for event in following)
    if not another_listens:
        following.close()
    service.scans.abort(scan.id)
    deadline = time.monotonic() + 100
    while not service.scans.get(scan.id).is_over:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    said, other = [], None
    for event in service.events.follow(kind="scan"):
        said.append(event)
        if event.kind == "ready":
            other = service.scans.create(slow_plan(service, 50).id)
        if event.kind == "scan" and other is not None and event.subject == other.id:
            break
    following.close()
    assert said[0].kind == "ready"
    assert ("progress", scan.id) not in [(event.kind, event.subject) for event in said]


def test_event_stream_unknown_last_event_id_yields_reset(service):
    """An id that the log does not know is a reset, and the stream goes on from now."""
    event = next(itertools.islice(service.events.follow(last_event_id="elsewhere.7"), 1))
    assert event.kind == "reset"


class Served:
    """A service of its own at one address, which can be killed and started anew."""

    def __init__(self, folder):
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.folder, self.url, self.process = folder, f"http://127.0.0.1:{self.port}", None

    def start(self):
        command = [sys.executable, "-m", "steradian", "serve", "--port", str(self.port), "--data", str(self.folder)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert " at " in self.process.stdout.readline()

    def kill(self):
        self.process.kill()
        self.process.wait(250)
        self.process.stdout.close()

    def pid_of(self, name):
        return json.loads((self.folder / "run" / f"{name}.json").read_text())["pid"]


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    service = Served(tmp_path_factory.mktemp("served"))
    service.start()
    yield service
    service.process.terminate()
    service.process.wait(250)
    service.process.stdout.close()


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_wait_outlasts_the_service_it_waits_for(served):
    """The service is killed and started anew while a reconstruction is waited for, which is done once."""
    with Client(served.url, patience=300) as client:
        scan = client.scans.wait(client.scans.create(slow_plan(client, 200).id), timeout=200)
        job = client.reconstructions.create(scan.id, modes=64, method="iterative")
        begun = threading.Event()
        with ThreadPoolExecutor(1) as pool:
            waited = pool.submit(client.reconstructions.wait, job, progress=lambda *_: begun.set(), timeout=500)
            assert begun.wait(200)
            served.kill()
            served.start()
            assert waited.result(500).state == "succeeded"
        assert [one.id for one in client.reconstructions.list()] == [job.id]
        assert client.reconstructions.volume(job.id, ":,:,0").values.shape == (64, 64)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_scan_resume_after_acquisition_kill_completes_same_scan(served):
    """The wait ends with the interruption; the scan goes on when it is asked to, and has each point once."""
    with Client(served.url, patience=300) as client:
        scan = client.scans.create(slow_plan(client).id)
        killed = []

        def kill(stage, done, total):
            if done >= 15 and not killed:
                killed.append(served.pid_of("acquisition"))
                os.kill(killed[0], signal.SIGKILL)

        with pytest.raises(JobFailed, match="interrupted"):
            client.scans.wait(scan, progress=kill, timeout=300)
        deadline = time.monotonic() + 200
        while served.pid_of("acquisition") == killed[0]:
            assert time.monotonic() < deadline
            time.sleep(0.1)
        stored = client.scans.coverage(scan.id).stored
        assert 0 < stored < client.scans.coverage(scan.id).points
        client.scans.resume(scan.id)
        while client.scans.get(scan.id).state == "interrupted":
            assert time.monotonic() < deadline + 200
            time.sleep(0.1)
        over = client.scans.wait(scan.id, timeout=300)
        assert over.state == "complete"
        shots = client.scans.shots(scan.id)
        assert all(shots.stored)
        assert over.summary["stored"] == over.summary["points"] == len(shots.points)
