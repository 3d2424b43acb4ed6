"""Finding scanners, sessions, and the small things of ports."""

from __future__ import annotations

import contextlib
import contextvars
import logging
import os
import re
import signal
import socket
import threading
import time

import numpy as np
import pytest
import serial
from serial import rfc2217

import fabry_perot
from fabry_perot.host import HostTiming, discovery
from fabry_perot.simulator import launch
from fabry_perot.wire import framing

PATIENT = HostTiming(ttl=1_000_000)  # this process may be held up by others
WORK = contextvars.ContextVar("WORK", default="")
"""What a program with logs of its own is at."""
PARAMETERS = {"samples": 64, "sampling_interval": 8e-9, "pulse_rate": 100.0}


def where(count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-6e-3, 6e-3, (count, 2)).round(6)


@pytest.fixture(scope="module")
def simulator():
    with launch(speed=20, tcp="127.0.0.1:0") as running:
        yield running


def test_discover_probe_identifies_scanner_and_omits_unresponsive_port(simulator, tmp_path):
    found = fabry_perot.discover([simulator.url, str(tmp_path / "nothing")], probe=True)
    assert [(item.url, item.serial, item.busy) for item in found] == [(simulator.url, "SIM-0000", False)]


def test_a_port_that_another_process_holds_is_reported_as_busy():
    with launch() as other, fabry_perot.connect(other.url):
        (found,) = fabry_perot.discover([other.url], probe=True)
    assert found.busy


def test_without_probing_nothing_is_sent_to_anybody(monkeypatch, tmp_path):
    monkeypatch.setattr(discovery, "connect", lambda *_, **__: pytest.fail("a port was opened"))
    assert fabry_perot.discover([str(tmp_path)])[0].url == str(tmp_path)
    assert isinstance(fabry_perot.discover(), list)


def test_connect_without_cobs_c_extension_logs_warning(simulator, monkeypatch, caplog):
    monkeypatch.setattr(framing.cobs, "_using_extension", False)
    with caplog.at_level(logging.WARNING), fabry_perot.connect(simulator.url):
        assert "C extension" in caplog.text


def test_scanner_is_tuned_set_and_paused_within_one_session(simulator):
    lines: list = []
    with fabry_perot.connect(simulator.url, timing=PATIENT) as scanner:
        assert scanner.capabilities.simulated
        assert scanner.tune(0.0, 0.0, steps=11).levels.shape == (11,)
        assert len(scanner.pretune(where(2), steps=11).wavelength) == 2
        assert scanner.set(interrogation_uw=900)["interrogation_uw"] == 900
        scanner.park()
        scanner.upload(where(600), **PARAMETERS)  # more than the device holds: its end waits for the host
        scanner.arm()
        scanner.disarm()
        assert scanner.state == "ready"
        scanner.start(scanner.arm())
        for batch in scanner.alines():
            if not lines:
                scanner.pause()
                assert scanner.state == "paused"
                scanner.resume()
            lines += batch
            scanner.acknowledge(batch[-1])
        assert scanner.statistics()["shots"] == scanner.status.shots
        report = scanner.report()
        scanner.abort("emergency-stop")
        scanner.clear_fault()
    assert [line.number for line in lines] == list(range(600))
    assert report.is_balanced
    assert report.stored == 600


def test_upload_with_start_measures_remaining_points_with_original_numbers(simulator):
    with fabry_perot.connect(simulator.url, timing=PATIENT) as scanner:
        with pytest.raises(fabry_perot.PlanInvalid, match="no scan"):
            scanner.report()
        with pytest.raises(fabry_perot.PlanInvalid, match="level"):
            scanner.abort("gently")
        scanner.upload(where(30), **PARAMETERS, start=20)
        scanner.start(scanner.arm())
        lines = []
        for batch in scanner.alines():
            lines += batch
            scanner.acknowledge(batch[-1])
        report = scanner.report()
    assert [line.number for line in lines] == list(range(20, 30))
    assert report.fired == report.stored == 10


def test_a_packed_scan_over_a_paced_line_takes_less_than_its_samples_would():
    """Other work of this machine only makes it longer, so one of several scans has to be that short."""
    samples, count, baud = 1024, 24, 921_600
    floor = count * samples * 2 * 10 / baud  # 16 bits each, and ten on the line for eight
    with launch(speed=2, baud=baud, noise_db=60.0) as paced, fabry_perot.connect(paced.url, timing=PATIENT) as scanner:

        def took(encoding):
            scanner.upload(where(count), samples=samples, sampling_interval=8e-9, pulse_rate=1000.0, encoding=encoding)
            scanner.start(scanner.arm())
            lines = []
            for batch in scanner.alines():
                lines += batch
                scanner.acknowledge(batch[-1])
            assert [line.samples.shape for line in lines] == [(samples,)] * count
            return scanner.statistics()["device_time"] * 1e-6 - lines[0].fire_time_s

        assert took("int16") > floor
        assert any(took("auto") < floor for _ in range(50))


class PortWithModemLines(serial.Serial):
    """A pseudo-terminal with the modem lines it lacks, which a terminal server reports."""

    cts = dsr = cd = property(lambda self: True)
    ri = property(lambda self: False)

    def _update_dtr_state(self) -> None: ...

    def _update_rts_state(self) -> None: ...


class NetworkAdapter:
    """A serial port behind RFC 2217, as a terminal server has it: pyserial's own server in front of a real port."""

    def __init__(self, path: str) -> None:
        self._port = PortWithModemLines(path, timeout=0.02, write_timeout=5.0)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = "rfc2217://{}:{}".format(*self._listener.getsockname())
        self.negotiated: list[int] = []
        self._over = threading.Event()
        self._threads = [threading.Thread(target=self._serve, daemon=True)]
        self._threads[0].start()

    def _serve(self) -> None:
        self._client, _ = self._listener.accept()
        self._manager = rfc2217.PortManager(self._port, self)
        self._threads.append(threading.Thread(target=self._upward, daemon=True))
        self._threads[1].start()
        while not self._over.is_set():
            data = self._port.read(self._port.in_waiting or 1)
            if data:
                self.write(b"".join(self._manager.escape(data)))

    def _upward(self) -> None:
        while data := self._client.recv(4096):
            self._port.write(b"".join(self._manager.filter(data)))
            self.negotiated.append(self._port.baudrate)
        self._over.set()

    def write(self, data: bytes) -> None:
        """Send to the client, for the port manager too."""
        with contextlib.suppress(OSError):
            self._client.sendall(data)

    def close(self) -> None:
        self._over.set()
        self._listener.close()
        with contextlib.suppress(OSError, AttributeError):
            self._client.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join(5.0)
        self._client.close()
        self._port.close()


@pytest.mark.filterwarnings("ignore:set:DeprecationWarning")  # pyserial's own
def test_a_scanner_behind_a_real_rfc_2217_server_scans_without_a_damaged_a_line_at_the_baud_rate_asked_for():
    with launch(speed=5, noise_db=60.0) as simulator:
        with fabry_perot.connect(simulator.url, timing=PATIENT) as scanner:
            direct = acquire(scanner)
        adapter = NetworkAdapter(simulator.url)
        try:
            with fabry_perot.connect(adapter.url, baudrate=921_600, timing=PATIENT) as scanner:
                remote = acquire(scanner)
                report = scanner.report()
        finally:
            adapter.close()
    assert [line.number for line in remote] == list(range(25))
    assert (report.stored, report.bad_frames) == (25, 0)
    assert 921_600 in adapter.negotiated, "the baud rate went to the far end's port"
    for near, far in zip(direct, remote, strict=True):
        assert np.corrcoef(near.samples, far.samples)[0, 1] > 0.99, "the same points of the same phantom"


def acquire(scanner: fabry_perot.Scanner) -> list:
    scanner.upload(where(25), samples=600, sampling_interval=8e-9, pulse_rate=100.0)
    scanner.start(scanner.arm())
    lines: list = []
    for batch in scanner.alines():
        lines += batch
        scanner.acknowledge(batch[-1])
    return lines


def test_second_tcp_host_raises_port_busy_naming_first_host(simulator):
    """No waiting for an answer that will not come: the error names the first host's address."""
    with fabry_perot.connect(simulator.url, timing=PATIENT) as first:
        with pytest.raises(fabry_perot.PortBusy, match=r"127\.0\.0\.1:\d+") as busy:
            fabry_perot.connect(simulator.url)
        assert simulator.url in str(busy.value)
        (found,) = fabry_perot.discover([simulator.url], probe=True)
        assert found.busy
        assert first.statistics()["host_reconnects"] == 0, "the first one is not disturbed"
    with fabry_perot.connect(simulator.url, timing=PATIENT) as next_one:
        assert next_one.state in ("linked", "ready", "done")


def test_a_second_host_on_a_terminal_hears_which_process_holds_it():
    with launch() as other, fabry_perot.connect(other.url), pytest.raises(fabry_perot.PortBusy) as busy:
        fabry_perot.connect(other.url)
    assert other.url in str(busy.value)
    assert f"process {os.getpid()}" in str(busy.value)


@pytest.mark.long
def test_scan_report_after_permanent_link_loss_is_available():
    """Every stored A-line is counted, and the fired shots as last heard; the report says how old that is."""
    brief = fabry_perot.RecoveryPolicy(patience=0.5)
    with launch(speed=5) as running, fabry_perot.connect(running.url, timing=PATIENT, recovery=brief) as scanner:
        scanner.upload(where(2000), **PARAMETERS)
        scanner.start(scanner.arm())
        stored = 0
        batches = scanner.alines()
        while stored < 50:
            stored += store(scanner, next(batches))
        running.send_command("unplug", seconds=10_000)
        rest = []
        with pytest.raises(fabry_perot.LinkLost):
            rest.extend(store(scanner, batch) for batch in batches)
        report = scanner.report()
        account = running.send_command("report")
    assert report.stored == stored + sum(rest)
    assert report.stored <= report.fired <= account["shots"]
    assert report.age > 0


def test_a_scanner_that_goes_silent_is_logged_once_while_it_is_silent_and_once_when_it_is_back(caplog, monkeypatch):
    """The driver's thread tells a filter of the program's own logs for what work it was connected."""
    works = []
    watch = [lambda record: works.append((record.threadName, WORK.get())) or True]
    monkeypatch.setattr(caplog.handler, "filters", watch)
    before = WORK.set("scan 7")
    with caplog.at_level(logging.INFO, "fabry_perot"), launch() as running:
        with fabry_perot.connect(running.url, timing=PATIENT) as scanner:
            begun, session = re.findall("session [0-9a-f]{4}", caplog.text), scanner._host.session
            caplog.clear()
            os.kill(running.pid, signal.SIGSTOP)
            try:
                until(lambda: "silent" in caplog.text)
                silent = [record.getMessage() for record in caplog.records]
            finally:
                os.kill(running.pid, signal.SIGCONT)
            until(lambda: "received again" in caplog.text)
            assert scanner.state == "linked"
    assert len(silent) == 1, "said once, not at each look"
    WORK.reset(before)
    assert begun == [f"session {session:04x}"]
    assert ("fabry-perot-io", "scan 7") in works
    assert ("fabry-perot-io", "") not in works


def test_a_port_that_is_gone_is_logged_when_it_goes_and_when_it_is_back(caplog):
    with caplog.at_level(logging.INFO, "fabry_perot"), launch(speed=20) as running:
        with fabry_perot.connect(running.url, timing=PATIENT):
            running.send_command("unplug", seconds=20)
            until(lambda: "the port is open again" in caplog.text)
    gone = [record.getMessage() for record in caplog.records if "is gone" in record.getMessage()]
    assert len(gone) == 1


def store(scanner, batch) -> int:
    scanner.acknowledge(batch[-1])
    return len(batch)


def until(condition) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)
