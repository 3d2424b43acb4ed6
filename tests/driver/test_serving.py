"""Hardware that is served: over a socket, a serial port and in one process, and at rest when the program ends."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
import time
from functools import partial

import numpy as np
import pytest

import fabry_perot
from fabry_perot.device.serve import DeviceServer
from fabry_perot.device.tcp import TcpEndpoint
from fabry_perot.errors import DeviceFault, PortBusy, PortUnavailable
from fabry_perot.hardware import ComposedInstrument, InstrumentError
from fabry_perot.hardware.composed import FAULT_DIGITISER
from fabry_perot.host.scanner import Scanner
from fabry_perot.simulator import phantoms
from fabry_perot.simulator.instrument import SimulatedInstrument
from fabry_perot.wire.messages import POINT

PARAMETERS = {"samples": 64, "sampling_interval": 8e-9, "pulse_rate": 500.0}


def served(instrument: ComposedInstrument, port: str) -> tuple[threading.Event, threading.Thread, str]:
    """Serve in a thread until the event is set."""
    over, known, urls = threading.Event(), threading.Event(), []

    def ready(url: str) -> None:
        urls.append(url)
        known.set()

    thread = threading.Thread(
        target=partial(fabry_perot.serve, instrument, port, stopping=over.is_set, ready=ready), daemon=True
    )
    thread.start()
    assert known.wait(250)
    return over, thread, urls[0]


def take_all(scanner: fabry_perot.Scanner) -> list:
    lines = []
    for batch in scanner.alines():
        lines += batch
        scanner.acknowledge(batch[-1])
    return lines


def collect(scanner: fabry_perot.Scanner) -> list:
    lines = []
    while True:
        try:
            return lines + take_all(scanner)
        except fabry_perot.LeaseExpired:  # this machine was busy with something else
            scanner.resume()


def check(scanner: fabry_perot.Scanner, instrument: SimulatedInstrument) -> None:
    where = np.column_stack([np.arange(60) * 1e-4 - 3e-3, np.zeros(60)])
    scanner.upload(where, **PARAMETERS)
    scanner.start(scanner.arm())
    lines = collect(scanner)
    assert [line.point for line in lines] == list(range(60))
    point = np.zeros((), POINT)
    for line in lines:
        point["x"] = round(where[line.point, 0] * 1e9)
        assert np.array_equal(line.samples, instrument.measure(point, line.shot).samples)
    assert scanner.report().fired == instrument.shots()


def test_an_instrument_that_is_served_is_a_scanner_to_its_host_and_rests_when_the_program_ends():
    instrument = SimulatedInstrument(phantoms.yarn(0))
    over, thread, url = served(instrument, "socket://127.0.0.1:0")
    with fabry_perot.connect(url) as scanner:
        check(scanner, instrument)
        scanner.upload(np.zeros((500, 2)), **PARAMETERS)
        scanner.start(scanner.arm())
        next(iter(scanner.alines()))
        assert instrument.shutter.is_open()
        over.set()
        thread.join(30)
    assert not instrument.shutter.is_open()
    with pytest.raises(PortUnavailable):
        fabry_perot.connect(url, recovery=None)


def test_the_laser_is_halted_at_the_end_of_the_program_even_if_the_shutter_does_not_answer(monkeypatch):
    instrument = SimulatedInstrument(phantoms.yarn(0))
    halted = []
    monkeypatch.setattr(instrument.excitation, "halt", halted.append)
    service = DeviceServer(instrument, TcpEndpoint("127.0.0.1:0"), ring=8, plan_points=8, max_payload=641)
    halted.clear()
    monkeypatch.setattr(instrument.shutter, "close", lambda: 1 // 0)
    with pytest.raises(InstrumentError):
        service.run(lambda: True)
    assert halted


FORGETFUL = """
import fabry_perot, numpy as np
from fabry_perot.simulator import phantoms
from fabry_perot.simulator.instrument import SimulatedInstrument

instrument = SimulatedInstrument(phantoms.yarn(0))
close, halt = instrument.shutter.close, instrument.excitation.halt
instrument.shutter.close = lambda: (print("closed", flush=True), close())
instrument.excitation.halt = lambda now: (print("halted", flush=True), halt(now))
scanner = fabry_perot.connect(instrument)
scanner.upload(np.zeros((5_000, 2)), samples=64, sampling_interval=8e-9, pulse_rate=500.0)
scanner.start(scanner.arm())
next(iter(scanner.alines()))
print("the end", flush=True)
"""


@pytest.mark.parametrize("last", ["", "raise RuntimeError('a bug of the application')"])
def test_a_program_that_ends_without_close_leaves_no_shutter_open(last):
    """The device of this process is what closes it: nobody else is left to have the lease lapse."""
    done = subprocess.run([sys.executable, "-c", FORGETFUL + last], capture_output=True, text=True, timeout=250)
    after = done.stdout.partition("the end")[2]
    assert "closed" in after, done.stderr
    assert "halted" in after


TOLD = """
import os, signal, time
os.kill(os.getpid(), signal.SIGTERM)
time.sleep(60)
"""
WHILE_CONNECTING = FORGETFUL.replace(
    "scanner = fabry_perot.connect",
    """
import os, signal
limits, instrument.capabilities = instrument.capabilities, lambda: os.kill(os.getpid(), signal.SIGTERM) or limits()
print("the end", flush=True)
scanner = fabry_perot.connect""",
)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a program without telling it")
@pytest.mark.parametrize("program", [FORGETFUL + TOLD, WHILE_CONNECTING], ids=["in mid-scan", "while it connects"])
def test_sigterm_closes_shutter_of_in_process_device(program):
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=250)
    assert "closed" in done.stdout.partition("the end")[2], done
    assert done.returncode == 128 + signal.SIGTERM


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a program without telling it")
def test_sigterm_handler_of_program_is_preserved():
    own = "import signal\nsignal.signal(signal.SIGTERM, lambda *_: print('own', flush=True))\n"
    later = TOLD.replace("time.sleep(60)", "scanner.close()\nprint(signal.getsignal(signal.SIGTERM).__name__)")
    done = subprocess.run([sys.executable, "-c", own + FORGETFUL + later], capture_output=True, text=True, timeout=250)
    assert (done.returncode, "own" in done.stdout, done.stdout.splitlines()[-1]) == (0, True, "<lambda>"), done


SERVING = """
import os, signal, sys
import fabry_perot
from fabry_perot.simulator import phantoms
from fabry_perot.simulator.instrument import SimulatedInstrument

instrument = SimulatedInstrument(phantoms.yarn(0))
close = instrument.shutter.close
instrument.shutter.close = lambda: (print("closed", flush=True), close())

def ready(url):
    print("ready", flush=True)
    if "at once" in sys.argv:
        os.kill(os.getpid(), signal.SIGTERM)

fabry_perot.serve(instrument, "socket://127.0.0.1:0", ready=ready)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a program without telling it")
def test_sigterm_while_serving_closes_shutter():
    with subprocess.Popen([sys.executable, "-c", SERVING], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert "ready\n" in iter(program.stdout.readline, "")
        program.terminate()
        assert "closed" in program.stdout.read()
    assert program.returncode == 128 + signal.SIGTERM


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a program without telling it")
def test_sigterm_before_first_serving_iteration_closes_shutter():
    program = subprocess.run([sys.executable, "-c", SERVING, "at once"], capture_output=True, text=True, timeout=250)
    assert "closed" in program.stdout.partition("ready")[2], program.stderr
    assert program.returncode == 128 + signal.SIGTERM


class Wire:
    """The host's end of a serial line whose other end is a port that somebody serves."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        os.set_blocking(descriptor, False)

    def read(self) -> bytes:
        select.select([self._descriptor], [], [], 0.02)
        try:
            return os.read(self._descriptor, 65536)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        while data:
            select.select([], [self._descriptor], [], 5)
            data = data[os.write(self._descriptor, data) :]

    def close(self) -> None: ...


def test_a_serial_port_is_served_as_a_socket_is_in_frames_that_suit_a_uart():
    instrument = SimulatedInstrument(phantoms.yarn(0))
    near, far = os.openpty()
    try:
        over, thread, url = served(instrument, os.ttyname(far))
        assert url == os.ttyname(far)
        with Scanner(Wire(near), recovery=fabry_perot.RecoveryPolicy()) as scanner:
            check(scanner, instrument)
            assert scanner.statistics()["payload"] == 641
        over.set()
        thread.join(30)
        assert not thread.is_alive()
    finally:
        os.close(near)
        os.close(far)


def test_an_instrument_in_the_same_process_is_connected_to_as_any_scanner():
    instrument = SimulatedInstrument(phantoms.yarn(0))
    with fabry_perot.connect(instrument) as scanner:
        assert scanner.capabilities.model == "simulated Fabry-Perot scanner"
        check(scanner, instrument)
        assert len(scanner.tune(0, 0, steps=21).levels) == 21
    assert not instrument.shutter.is_open()


def test_the_lease_holds_in_the_same_process_too():
    """An application that takes no A-lines for a while keeps no laser on, though everything runs in its process."""
    instrument = SimulatedInstrument(phantoms.yarn(0))
    with fabry_perot.connect(instrument, recovery=fabry_perot.RecoveryPolicy(within=0.0)) as scanner:
        scanner.upload(np.zeros((5_000, 2)), **PARAMETERS)
        scanner.start(scanner.arm())
        next(iter(scanner.alines()))
        deadline = time.monotonic() + 30
        while scanner.state != "safe_hold":
            assert time.monotonic() < deadline
            time.sleep(0.05)
        shots = instrument.shots()
        assert not instrument.shutter.is_open()
        with pytest.raises(fabry_perot.LeaseExpired):
            take_all(scanner)
        assert instrument.shots() == shots


def test_a_fault_of_a_part_reaches_the_application_in_the_same_process(monkeypatch):
    instrument = SimulatedInstrument(phantoms.yarn(0))
    with fabry_perot.connect(instrument) as scanner:
        scanner.upload(np.zeros((500, 2)), **PARAMETERS)
        scanner.start(scanner.arm())
        monkeypatch.setattr(instrument.digitiser, "records", lambda now: 1 // 0)
        with pytest.raises(DeviceFault, match=str(FAULT_DIGITISER)) as raised:
            take_all(scanner)
        assert "division" in str(raised.value), "the part's own words"
        assert scanner.state == "fault"
        assert not instrument.shutter.is_open()


def test_hardware_has_one_host_in_its_process_too():
    """A second one is told at once; when the first is gone, it is welcome."""
    instrument = SimulatedInstrument(phantoms.yarn(0))
    with fabry_perot.connect(instrument), pytest.raises(PortBusy, match="this process"):
        fabry_perot.connect(instrument)
    with fabry_perot.connect(instrument) as scanner:
        check(scanner, instrument)
