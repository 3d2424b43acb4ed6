"""The scanner's state between and during scans: what is shown, for how long, and what happens to the port meanwhile."""

import socket
import time
from contextlib import contextmanager, suppress
from dataclasses import replace

import pytest

import fabry_perot
from fabry_perot.host.port_usage import lock_owner
from fabry_perot.simulator import launch
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.scans.acquisition.emergency_watchdog import EmergencyWatchdog
from steradian.scans.acquisition.port_monitor import PortMonitor
from steradian.scans.acquisition.run import run_scan
from steradian.scans.acquisition.session_control import SessionControl
from steradian.storage.data_dir.emergency_latch import EmergencyLatch
from steradian.storage.data_dir.scanner_status import CURRENT, SILENT_ACQUISITION, ScannerStatus, StatusBlock
from support.waiting import until


@pytest.fixture(scope="module")
def scanner():
    with launch(speed=20.0) as simulator:
        yield simulator


class Port:
    """A scanner's port, or none."""

    def __init__(self, url):
        self.here = url

    def present(self):
        return self.here


class Watched:
    """A port with its watch, and the block that it writes."""

    def __init__(self, folder, url, **how):
        self.block, self.notes = StatusBlock(folder), []
        self.watch = PortMonitor(Port(url), self.block, self.notes.append, **how)

    def until(self, **expected):
        """Wait until the block says so."""
        says = lambda now: all(getattr(now, name) == value for name, value in expected.items())  # noqa: E731
        return until(lambda: says(now := self.block.read()) and now, tell=self.block.read)


@contextmanager
def watched(folder, url, **how):
    port = Watched(folder, url, **how)
    with port.watch.watching():
        yield port


def test_status_block_older_than_one_second_reads_unknown(tmp_path):
    block, now = StatusBlock(tmp_path), time.monotonic()
    status = ScannerStatus("connected", "ready", "off", "closed", "closed", "on", serial="7", heard=now)
    assert StatusBlock(tmp_path).read() == ScannerStatus()
    block.write(status)
    assert StatusBlock(tmp_path).read() == status
    old = replace(status, heard=now - CURRENT - 0.1)
    block.write(old)
    read = StatusBlock(tmp_path).read()
    assert (read.laser, read.shutter, read.interlock, read.key) == ("unknown",) * 4
    assert (read.connection, read.serial) == ("connected", "7")
    assert read.age() > CURRENT


def test_status_block_of_ended_acquisition_reads_unknown(tmp_path, monkeypatch):
    block = StatusBlock(tmp_path)
    block.write(ScannerStatus("connected", "ready", "off", "closed", "closed", "on", heard=time.monotonic()))
    later = time.monotonic() + 2
    monkeypatch.setattr(time, "monotonic", lambda: later)
    read = block.read()
    assert (read.connection, read.laser, read.error) == ("unknown", "unknown", SILENT_ACQUISITION)
    monkeypatch.setattr(time, "monotonic", lambda: 1.0)
    assert block.read().laser == "unknown", "the computer was started anew: the clock began again"


def test_status_between_scans_follows_scanner_interlock(tmp_path, scanner):
    with watched(tmp_path, scanner.url) as port:
        shown = port.until(connection="connected", laser="off", interlock="closed", key="on", error=None)
        assert shown.serial
        scanner.send_command("interlock", closed=False)
        port.until(interlock="open")
        scanner.send_command("interlock", closed=True)
        port.until(interlock="closed")
        until(lambda: port.notes and port.notes[-1].interlock == "closed")


def test_status_of_missing_port_reports_error_and_recovers(tmp_path):
    url = tmp_path / "port"
    with watched(tmp_path / "block", str(url)) as port:
        shown = port.until(connection="disconnected", laser="unknown")
        until(lambda: str(url) in (port.block.read().error or ""))
        assert shown.heard is None
        with launch(link=str(url)):
            port.until(connection="connected", laser="off", error=None)


def test_status_without_a_monitor_is_unknown_and_leaves_the_port_free(tmp_path, scanner):
    with watched(tmp_path, scanner.url, listens=False) as port:
        until(lambda: port.watch._serial)
        port.until(connection="unknown", laser="unknown", error=None)
        until(lambda: lock_owner(scanner.url) is None)
        with fabry_perot.connect(scanner.url):
            pass
        assert port.watch.stop("Ada").laser == "off"


def test_status_of_a_simulated_scanner_that_was_not_started_is_off(tmp_path):
    with watched(tmp_path, None) as port:
        port.until(connection="unknown", laser="off")
        assert port.watch.stop("Ada") is None


def test_port_lent_to_a_scan_that_fails_is_watched_again(tmp_path, scanner):
    with watched(tmp_path, scanner.url) as port:
        port.until(connection="connected")
        with suppress(RuntimeError), port.watch.lent():
            with fabry_perot.connect(scanner.url) as connected, port.watch.guarding(connected):
                port.until(connection="connected", laser="off")
                raise RuntimeError("a fault of our own")
        monitor = until(lambda: port.watch._monitor)
        until(lambda: monitor.connection == "connected")


def test_a_monitor_that_cannot_be_opened_is_tried_again(tmp_path, scanner, monkeypatch):
    opened, monitor = [], fabry_perot.Monitor

    def fails_first(url):
        opened.append(url)
        if len(opened) == 1:
            raise RuntimeError("whatever it was")
        return monitor(url)

    monkeypatch.setattr(fabry_perot, "Monitor", fails_first)
    with watched(tmp_path, scanner.url) as port:
        port.until(connection="connected", laser="off")
    assert len(opened) > 1


def test_status_of_starting_scan_is_armed_before_scanner_may_fire(tmp_path, scanner):
    told = []

    class Looks(SessionControl):
        def monitor(self, connected):
            self.scanner = connected
            return emergency.protect(connected)

        def may_fire(self, allowed):
            emergency.may_fire(allowed)
            if allowed:
                told.append((self.scanner.state, port.block.read().laser))

    mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=60)
    plan = ScanPlan.create(mask=mask, samples=256, pulse_rate=100.0)
    with watched(tmp_path, scanner.url) as port:
        emergency = EmergencyWatchdog(EmergencyLatch(tmp_path), port.watch)
        with port.watch.lent():
            run_scan(plan, scanner.url, tmp_path / "a.h5", control=Looks())
        port.until(connection="connected", laser="off")
    assert told == [("ready", "armed")]


def test_stop_while_a_scan_connects_asks_the_scanner_through_its_port(tmp_path, scanner):
    with watched(tmp_path, scanner.url) as port:
        port.until(connection="connected")
        with port.watch.lent():
            assert port.watch.stop("Ada").laser == "off"


@pytest.mark.long
def test_status_of_a_port_on_which_nothing_answers_is_noted_and_logged_once(tmp_path, caplog):
    caplog.set_level("INFO", "steradian")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"socket://127.0.0.1:{silent.getsockname()[1]}"
        with watched(tmp_path, url) as port:
            shown = port.until(connection="disconnected", laser="unknown")
            first = until(lambda: (now := port.block.read().error) and "received nothing" in now and now)
            until(lambda: port.block.read().error not in (first, None))  # the seconds in it pass
            assert shown.heard is None
            said = [one.getMessage() for one in caplog.records if "is disconnected" in one.getMessage()]
            assert len([one for one in said if "received nothing" in one]) == 1, said
            assert len({one.error for one in port.notes if one.error and "received nothing" in one.error}) == 1
