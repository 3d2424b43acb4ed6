"""Hardware made of parts: blocks by its own triggers, a lease it keeps, sweeps that end, faults that name a part."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from driver_bench import Bench

import fabry_perot
from fabry_perot.device import Device
from fabry_perot.device.endpoints import TcpEndpoint
from fabry_perot.device.serving import Service
from fabry_perot.errors import DeviceFault, PortUnavailable, Refused
from fabry_perot.hardware import Apparatus, InstrumentError, Sampling
from fabry_perot.hardware.apparatus import FAULT_DIGITISER, FAULT_EXCITATION, FAULT_GALVO, FAULT_GUARD, FAULT_LASER
from fabry_perot.host import Plan
from fabry_perot.host.scanner import Scanner
from fabry_perot.simulator import phantoms
from fabry_perot.simulator.film import Response
from fabry_perot.simulator.instrument import PhantomInstrument
from fabry_perot.wire.codes import AbortLevel, Operation
from fabry_perot.wire.messages import POINT
from fabry_perot.wire.states import DeviceState

PARAMETERS = {"samples": 64, "sampling_interval": 8e-9, "pulse_rate": 500.0}


def points(count: int, **columns) -> np.ndarray:
    made = np.zeros(count, POINT)
    made["x"], made["averages"] = np.arange(count) * 50_000, 1
    for name, values in columns.items():
        made[name] = values
    return made


def ready(rate: int = 500_000, **settings) -> PhantomInstrument:
    """An instrument set up for a plan, with its shutter open and a lease of a minute."""
    instrument = PhantomInstrument(phantoms.yarn(0), **settings)
    instrument.begin(Sampling(64, 8000, rate))
    instrument.open()
    instrument.permit(60_000_000, 0)
    return instrument


def calls(monkeypatch, part: object, name: str) -> list[tuple]:
    """Note every call of a part's method."""
    made, method = [], getattr(part, name)
    monkeypatch.setattr(part, name, lambda *given: made.append(given) or method(*given))
    return made


def run(instrument: PhantomInstrument, until: int, step: int = 1_000, start: int = 0) -> list:
    return [taken for now in range(start, until, step) for taken in instrument.poll(now)]


def test_points_of_one_wavelength_are_one_block_of_the_hardwares_own_triggers(monkeypatch):
    instrument = ready()
    armed = calls(monkeypatch, instrument.digitiser, "arm")
    fired = calls(monkeypatch, instrument.excitation, "fire")
    instrument.queue(0, points(40, averages=3), 0)
    taken = run(instrument, 400_000)
    assert [each.point for each in taken] == list(range(40))
    assert all(each.averages == 3 for each in taken)
    assert [given[0] for given in armed] == [given[0] for given in fired] == [120], "one call for 120 shots"


def test_a_block_ends_where_the_wavelength_changes_and_is_one_point_for_a_galvo_that_cannot_step(monkeypatch):
    instrument = ready()
    armed = calls(monkeypatch, instrument.digitiser, "arm")
    instrument.queue(0, points(9, wavelength=[1_548_000] * 4 + [1_549_000] * 5), 0)
    assert [each.wavelength for each in run(instrument, 100_000)] == [1_548_000] * 4 + [1_549_000] * 5
    assert [given[0] for given in armed] == [4, 5]
    instrument.galvo.steps_by_trigger = False
    armed.clear()
    instrument.queue(9, points(4), 100_000)
    assert len(run(instrument, 200_000, start=100_000)) == 4
    assert [given[0] for given in armed] == [1, 1, 1, 1]


def test_blocks_record_what_single_shots_do_whenever_software_looks():
    """The truth of each A-line from point and shot number alone; a look each 50 µs or 150 ms finds the same."""
    where = points(30, averages=1, y=np.arange(30) * -70_000)
    often, seldom = ready(), ready()
    for instrument in (often, seldom):
        instrument.queue(0, where, 0)
    one, other = run(often, 150_000, step=50), run(seldom, 600_000, step=150_000)
    assert len(one) == len(other) == 30
    for first, second in zip(one, other, strict=True):
        assert np.array_equal(first.samples, often.measure(where[first.point], first.shot).samples)
        assert np.array_equal(first.samples, second.samples)
        assert (first.fire_time, first.shot) == (second.fire_time, second.shot)


def test_no_pulse_leaves_after_the_permission_even_if_nobody_calls_again():
    instrument = ready()
    instrument.queue(0, points(60, averages=5), 0)
    instrument.poll(0)
    instrument.poll(2_000)
    instrument.permit(50_000, 2_000)
    instrument.poll(5_000_000)
    assert 20 <= instrument.shots() <= 25
    assert instrument.last_shot() < 50_000
    instrument.permit(5_100_000, 5_000_000)
    assert run(instrument, 5_100_000, start=5_000_000)
    times = np.array([time for time, _ in instrument.log])
    assert not np.any((times >= 50_000) & (times < 5_000_000)), "the time without permission is not made up for"


def test_a_stop_keeps_what_is_whole_and_wastes_the_rest():
    instrument = ready()
    instrument.queue(0, points(10, averages=4), 0)
    taken = run(instrument, 21_000)
    instrument.stop(21_000)
    taken += instrument.poll(21_000)
    shots = instrument.shots()
    assert 8 <= shots < 12
    assert len(taken) == shots // 4
    assert instrument.next_due(24_000) is None
    run(instrument, 100_000, start=24_000)
    assert instrument.shots() == shots


def test_a_sweep_is_a_job_that_ends_and_nobody_waits_for_it():
    instrument = PhantomInstrument(phantoms.yarn(0), seed=3, response=Response(nonlinear=True))
    wavelengths = np.linspace(1_546_000, 1_554_000, 81).round().astype(np.int64)
    instrument.sweep(1_000_000, -2_000_000, wavelengths, 0)
    now, levels = 0, None
    while levels is None:
        levels = instrument.swept(now)
        due = instrument.next_due(now)
        assert levels is not None or due is not None
        now = max(now + 1, due or 0)
    truth = instrument.recorder.film.level(1_000_000, -2_000_000, wavelengths.astype(float))
    assert levels == pytest.approx(truth, abs=0.51)
    assert now > 80 * 200
    assert instrument.swept(now) is None, "told once"


PARTS = {
    "galvo": ("follow", FAULT_GALVO),
    "laser": ("tune", FAULT_LASER),
    "digitiser": ("arm", FAULT_DIGITISER),
    "excitation": ("fire", FAULT_EXCITATION),
    "shutter": ("interlock_closed", FAULT_GUARD),
}


@pytest.mark.parametrize("part", PARTS)
def test_whatever_a_part_raises_is_a_fault_of_that_part(part, monkeypatch):
    instrument = ready()
    name, fault = PARTS[part]

    def fail(*given: object) -> None:
        raise ConnectionResetError("no answer on the bus")

    monkeypatch.setattr(getattr(instrument, part), name, fail)
    instrument.queue(0, points(3), 0)
    act = instrument.interlock_closed if part == "shutter" else partial(run, instrument, 10_000)
    with pytest.raises(InstrumentError, match="no answer on the bus") as caught:
        act()
    assert caught.value.fault == fault


def test_a_digitiser_that_misses_a_trigger_is_a_fault_and_no_shot_is_counted_to_the_wrong_point(monkeypatch):
    instrument = ready()
    trigger, count = instrument.digitiser.trigger, iter(range(1_000))
    monkeypatch.setattr(instrument.digitiser, "trigger", lambda *given: trigger(*given) if next(count) != 5 else None)
    instrument.queue(0, points(4, averages=4), 0)
    with pytest.raises(InstrumentError, match="missing") as caught:
        run(instrument, 400_000)
    assert caught.value.fault == FAULT_DIGITISER


@pytest.mark.parametrize("averages", [1, 2])
def test_a_record_of_another_length_than_was_asked_for_is_a_fault_of_the_digitiser(averages, monkeypatch):
    instrument = ready()
    records, cut = instrument.digitiser.records, iter(range(1_000))

    def short(now: int) -> list:
        return [replace(each, samples=each.samples[: 32 if next(cut) == 1 else None]) for each in records(now)]

    monkeypatch.setattr(instrument.digitiser, "records", short)
    instrument.queue(0, points(4, averages=averages), 0)
    with pytest.raises(InstrumentError, match="32 samples") as caught:
        run(instrument, 400_000)
    assert caught.value.fault == FAULT_DIGITISER


class Real(Bench):
    """A bench whose hardware is the simulator's apparatus."""

    def boot(self, boot: int) -> Device:
        self.instrument = PhantomInstrument(phantoms.yarn(0))
        return Device(self.instrument, boot=boot, now=self.device_now, **self.options)

    def upload(self, count: int = 50, *, averages: int = 1, **columns) -> Plan:
        plan = Plan(points(count, averages=averages, **columns), 64, 8000, 500_000)
        call = self.host.upload(plan, self.clock.now())
        self.until(lambda: call.done and self.device.state is DeviceState.READY)
        return plan


def test_a_scan_of_an_apparatus_is_exact_and_its_shots_are_accounted_for_over_a_pause():
    bench = Real(ring=8)
    bench.scan(40, averages=3)
    bench.until(lambda: bench.instrument.shots() == 50)
    bench.host.abort(AbortLevel.PAUSE, bench.clock.now())
    bench.run(60)
    assert bench.device.state is DeviceState.PAUSED
    shots = bench.instrument.shots()
    bench.run(200)
    assert bench.instrument.shots() == shots
    bench.start()
    bench.finish()
    assert [line.point for line in bench.stored] == list(range(40))
    wasted = bench.device.scan.shots_wasted
    assert 1 <= wasted <= 2
    assert bench.instrument.shots() == bench.device.scan.shots == 120 + wasted
    assert all(line.shot <= bench.instrument.shots() for line in bench.stored)


def test_a_full_ring_never_has_more_shots_fired_than_it_can_hold():
    bench = Real(ring=6)
    bench.acknowledging = False
    bench.scan(40)
    bench.run(300)
    assert bench.device.state is DeviceState.BLOCKED
    assert bench.instrument.shots() == 6 == bench.device.ring.fill


@pytest.mark.parametrize("end", ["emergency stop", "new session", "hardware"])
def test_a_sweep_that_is_cut_short_ends_and_its_hardware_rests(end, monkeypatch):
    bench = Real()
    bench.connect()
    stopped = calls(monkeypatch, bench.instrument, "stop")
    sweep = {"x": 0, "y": 0, "from_pm": 1_546_000, "to_pm": 1_554_000, "steps": 256}
    call = bench.host.call(Operation.TUNE_SCAN, bench.clock.now(), **sweep)
    bench.run(20)
    assert not call.done
    if end == "emergency stop":
        bench.host.abort(AbortLevel.EMERGENCY_STOP, bench.clock.now())
        reason = "wrong-state"
    elif end == "hardware":
        monkeypatch.setattr(bench.instrument.digitiser, "level", lambda now: 1 // 0)
        reason = "hardware-fault"
    else:
        bench.host.nonce += 1
        bench.host.open(bench.clock.now())
        reason = "renewed"
    bench.until(lambda: call.done, 2_000)
    assert stopped
    assert bench.instrument.next_due(bench.device_now) is None
    with pytest.raises((Refused, fabry_perot.LinkLost), match=reason):
        call.result()
    assert (bench.device.state in (DeviceState.ESTOP, DeviceState.FAULT)) is (end != "new session")


def served(instrument: Apparatus, port: str) -> tuple[threading.Event, threading.Thread, str]:
    """Serve in a thread until the event is set."""
    over, known, urls = threading.Event(), threading.Event(), []

    def ready(url: str) -> None:
        urls.append(url)
        known.set()

    thread = threading.Thread(
        target=partial(fabry_perot.serve, instrument, port, stopping=over.is_set, ready=ready), daemon=True
    )
    thread.start()
    assert known.wait(30)
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
        except fabry_perot.LeaseLapsed:  # this machine was busy with something else
            scanner.resume()


def check(scanner: fabry_perot.Scanner, instrument: PhantomInstrument) -> None:
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
    instrument = PhantomInstrument(phantoms.yarn(0))
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
    instrument = PhantomInstrument(phantoms.yarn(0))
    halted = calls(monkeypatch, instrument.excitation, "halt")
    service = Service(instrument, TcpEndpoint("127.0.0.1:0"), ring=8, plan_points=8, max_payload=641)
    halted.clear()
    monkeypatch.setattr(instrument.shutter, "close", lambda: 1 // 0)
    with pytest.raises(InstrumentError):
        service.run(lambda: True)
    assert halted


FORGETFUL = """
import fabry_perot, numpy as np
from fabry_perot.simulator import phantoms
from fabry_perot.simulator.instrument import PhantomInstrument

instrument = PhantomInstrument(phantoms.yarn(0))
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
    done = subprocess.run([sys.executable, "-c", FORGETFUL + last], capture_output=True, text=True, timeout=100)
    after = done.stdout.partition("the end")[2]
    assert "closed" in after, done.stderr
    assert "halted" in after


SERVING = """
import os, signal, sys
import fabry_perot
from fabry_perot.simulator import phantoms
from fabry_perot.simulator.instrument import PhantomInstrument

instrument = PhantomInstrument(phantoms.yarn(0))
close = instrument.shutter.close
instrument.shutter.close = lambda: (print("closed", flush=True), close())

def ready(url):
    print("ready", flush=True)
    if "at once" in sys.argv:
        os.kill(os.getpid(), signal.SIGTERM)

fabry_perot.serve(instrument, "socket://127.0.0.1:0", ready=ready)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a program without telling it")
def test_a_service_that_is_told_to_end_closes_the_shutter():
    with subprocess.Popen([sys.executable, "-c", SERVING], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert "ready\n" in iter(program.stdout.readline, "")
        program.terminate()
        assert "closed" in program.stdout.read()
    assert program.returncode == 128 + signal.SIGTERM


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a program without telling it")
def test_a_service_that_is_told_to_end_before_its_first_turn_closes_the_shutter():
    program = subprocess.run([sys.executable, "-c", SERVING, "at once"], capture_output=True, text=True, timeout=100)
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
    instrument = PhantomInstrument(phantoms.yarn(0))
    near, far = os.openpty()
    try:
        over, thread, url = served(instrument, os.ttyname(far))
        assert url == os.ttyname(far)
        with Scanner(Wire(near), recovery=fabry_perot.Recovery()) as scanner:
            check(scanner, instrument)
            assert scanner.statistics()["payload"] == 641
        over.set()
        thread.join(30)
        assert not thread.is_alive()
    finally:
        os.close(near)
        os.close(far)


def test_an_instrument_in_the_same_process_is_connected_to_as_any_scanner():
    instrument = PhantomInstrument(phantoms.yarn(0))
    with fabry_perot.connect(instrument) as scanner:
        assert scanner.capabilities.model == "simulated Fabry-Perot scanner"
        check(scanner, instrument)
        assert len(scanner.tune(0, 0, steps=21).levels) == 21
    assert not instrument.shutter.is_open()


def test_the_lease_holds_in_the_same_process_too():
    """An application that takes no A-lines for a while keeps no laser on, though everything runs in its process."""
    instrument = PhantomInstrument(phantoms.yarn(0))
    with fabry_perot.connect(instrument, recovery=fabry_perot.Recovery(within=0.0)) as scanner:
        scanner.upload(np.zeros((5_000, 2)), **PARAMETERS)
        scanner.start(scanner.arm())
        next(iter(scanner.alines()))
        deadline = time.monotonic() + 30
        while scanner.state != "safe_hold":
            assert time.monotonic() < deadline
            time.sleep(0.05)
        shots = instrument.shots()
        assert not instrument.shutter.is_open()
        with pytest.raises(fabry_perot.LeaseLapsed):
            take_all(scanner)
        assert instrument.shots() == shots


def test_a_fault_of_a_part_reaches_the_application_in_the_same_process(monkeypatch):
    instrument = PhantomInstrument(phantoms.yarn(0))
    with fabry_perot.connect(instrument) as scanner:
        scanner.upload(np.zeros((500, 2)), **PARAMETERS)
        scanner.start(scanner.arm())
        monkeypatch.setattr(instrument.digitiser, "records", lambda now: 1 // 0)
        with pytest.raises(DeviceFault, match=str(FAULT_DIGITISER)):
            take_all(scanner)
        assert scanner.state == "fault"
        assert not instrument.shutter.is_open()
