"""The emergency stop of a real service reaches a real simulated laser, whatever has become of the database."""

import os
import shutil
import socket
import sqlite3
import subprocess
import time
import uuid
from contextlib import contextmanager, suppress

import pytest

from fabry_perot.simulator import launch
from steradian.security.keys import KeyStore, Scope
from steradian.storage.data_dir.emergency_latch import EmergencyLatch
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database, metadata_url
from support.services import Service
from support.waiting import until

STOP = "/scanners/scanner-0/emergency-stop"
BRIEF = pytest.mark.timeout(300)


class Watched(Service):
    """A service on a scanner that tells when it fired."""

    def __init__(self, folder, scanner, **settings):
        self.scanner = scanner
        super().__init__(folder, scanner=scanner.url, workers=1, **settings)

    def fire(self):
        """Begin a scan of minutes and return its identifier once the laser fires."""
        shots = self.scanner.send_command("report")["shots"]
        scan = self.start_scan(self.plan(1600, pulse_rate=10))
        until(lambda: self.scanner.send_command("report")["shots"] > shots + 2)
        return scan["id"]

    def press(self, **headers):
        """Press the stop; returns the answer, and the scanner's own account of the moment before and after it."""
        before = self.scanner.send_command("report")
        answer = self.http.post(STOP, json={"reason": "smoke"}, headers=headers)
        return answer, before, self.scanner.send_command("report")

    def assert_dark(self, answer, after):
        """No shot since the answer, and none for as long as fifteen pulses would take."""
        assert answer.status_code == 202, answer.text
        assert answer.json()["emergency_stop"]["laser"] == "off", answer.json()
        until(lambda: self.scanner.send_command("report")["time"] > after["time"] + 1_500_000)
        later = self.scanner.send_command("report")
        assert (later["shots"], later["last_shot"]) == (after["shots"], after["last_shot"])


@contextmanager
def running(folder, **settings):
    with launch(tcp="127.0.0.1:0") as scanner:
        service = Watched(folder, scanner, **settings).start()
        try:
            yield service
        finally:
            service.close()


@pytest.mark.long
@BRIEF
def test_a_locked_database_and_threads_that_wait_for_it_delay_no_stop_which_is_recorded_when_it_is_free(tmp_path):
    with running(tmp_path) as service:
        scan = service.fire()
        with sqlite3.connect(tmp_path / "steradian.sqlite", isolation_level=None) as holder:
            holder.execute("BEGIN EXCLUSIVE")
            lease = '{"holder": "Ada", "seconds": 5}'
            waiting = [_ask(service, "PUT /api/v1/scanners/scanner-0/lease", lease) for _ in range(60)]
            time.sleep(0.5)  # the service has forty threads for them
            answer, _, after = service.press()
            service.assert_dark(answer, after)
            assert answer.json()["emergency_stop"]["recorded"] is False
            holder.execute("ROLLBACK")
        holder.close()
        for connection in waiting:
            connection.close()
        until(lambda: service.http.get(f"/scans/{scan}").json()["state"] in {"aborted", "interrupted"})
        until(lambda: _stop_of(service)["recorded"])
        shown = _stop_of(service)
        assert (shown["by"], shown["reason"], shown["laser"]) == ("local", "smoke", "off")


@pytest.mark.long
@BRIEF
def test_a_full_disk_delays_no_stop(tmp_path):
    if os.geteuid() or shutil.which("mount") is None:
        pytest.skip("needs root to mount a small file system: run as root, or in the container")
    small = tmp_path / "small"
    small.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(small)], capture_output=True).returncode:
        pytest.skip("needs the right to mount a small file system: in a container --cap-add SYS_ADMIN")
    try:
        with running(small / "data", log=tmp_path / "service.log") as service:
            service.fire()
            _fill(small / "filler")
            answer, _, after = service.press()
            service.assert_dark(answer, after)
            (small / "filler").unlink()
            until(lambda: _stop_of(service)["recorded"])
    finally:
        subprocess.run(["umount", "-l", str(small)], check=True)


@pytest.mark.long
@BRIEF
def test_a_dead_database_server_delays_no_stop_and_a_key_is_known_without_it(tmp_path, postgres):
    with running(tmp_path, database_url=postgres.database()) as service:
        store = KeyStore(database := Database(metadata_url(service.settings)))
        key = store.create("ward", [Scope.READ])
        database.close()
        service.fire()
        assert service.http.get("/", headers={"Authorization": f"Bearer {key}"}).is_success
        time.sleep(2.5)  # keys are looked at every second
        postgres.kill()
        try:
            assert service.http.get("/scans").status_code == 503
            unknown = service.http.post(STOP, headers={"Authorization": "Bearer sk_000000000000_x"})
            assert unknown.status_code == 503
            answer, _, after = service.press(Authorization=f"Bearer {key}")
            service.assert_dark(answer, after)
        finally:
            postgres.start()
        until(lambda: service.http.get("/scanners/scanner-0").is_success)
        until(lambda: _stop_of(service)["recorded"])
        assert "ward" in _stop_of(service)["by"]


@pytest.mark.long
@BRIEF
def test_a_stop_outlives_a_restart_and_only_a_release_ends_it(tmp_path):
    with running(tmp_path) as service:
        scan = service.fire()
        answer, _, after = service.press()
        service.assert_dark(answer, after)
        until(lambda: service.http.get(f"/scans/{scan}").json()["state"] == "aborted")
        service.close()
        service.start()
        assert _stop_of(service)["reason"] == "smoke"
        plan = service.http.get(f"/scans/{scan}").json()["plan_id"]
        key = {"Idempotency-Key": uuid.uuid4().hex}
        refused = service.http.post("/scans", json={"plan_id": plan}, headers=key)
        assert (refused.status_code, refused.json()["code"]) == (409, "emergency-stopped")
        assert service.http.delete(STOP).json()["emergency_stop"] is None
        key = {"Idempotency-Key": uuid.uuid4().hex}
        again = service.http.post("/scans", json={"plan_id": plan}, headers=key)
        assert again.status_code == 201
        until(lambda: service.scanner.send_command("report")["shots"] > after["shots"])


def test_latch_with_damaged_block_counts_as_pressed_until_released(tmp_path):
    data = DataDirectory(tmp_path)
    data.create()
    latch, other = EmergencyLatch(data.emergency), EmergencyLatch(data.emergency)
    assert latch.active() is None
    first = latch.press("Ada", "smoke " + "ß" * 500)
    assert other.active() == first
    second = other.press("Ben", None)
    latch.release(first.number)
    assert latch.active() == second, "who releases what he saw releases nothing that came after it"
    latch.release(second.number)
    assert other.active() is None
    with (data.emergency / "pressed").open("r+b") as file:
        file.write(b"\xff" * 100)
    torn = latch.active()
    assert torn is not None
    assert "cannot be read" in torn.reason
    latch.release(torn.number)
    assert other.active() is None


def _stop_of(service):
    return service.http.get("/scanners/scanner-0").json()["emergency_stop"]


def _fill(path):
    with path.open("wb", buffering=0) as filler:
        for size in (1 << 16, 1):
            with suppress(OSError):
                while True:
                    filler.write(bytes(size))


def _ask(service, request, body):
    """Send a request whose answer nobody reads; returns its connection."""
    url = service.http.base_url
    connection = socket.create_connection((url.host, url.port))
    head = f"{request} HTTP/1.1\r\nHost: {url.netloc.decode()}\r\nContent-Type: application/json\r\n"
    connection.sendall(f"{head}Content-Length: {len(body)}\r\n\r\n{body}".encode())
    return connection
