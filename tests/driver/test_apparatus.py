"""Hardware made of parts: blocks by its own triggers, a lease it keeps, sweeps that end, faults that name a part."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from driver_bench import Bench

import fabry_perot
from fabry_perot.device import Device
from fabry_perot.errors import RequestRejected
from fabry_perot.hardware import InstrumentError, PlanSampling, TriggerRecord
from fabry_perot.hardware.averaging import average_shots
from fabry_perot.hardware.composed import FAULT_DIGITISER, FAULT_EXCITATION, FAULT_GALVO, FAULT_GUARD, FAULT_LASER
from fabry_perot.host import WirePlan
from fabry_perot.simulator import launch, phantoms
from fabry_perot.simulator.film import Response
from fabry_perot.simulator.instrument import SimulatedInstrument
from fabry_perot.wire.constants import FLAG_GATE, MISFIRE, AbortLevel, Operation
from fabry_perot.wire.messages import POINT
from fabry_perot.wire.states import DeviceState


def points(count: int, **columns) -> np.ndarray:
    made = np.zeros(count, POINT)
    made["x"], made["averages"] = np.arange(count) * 50_000, 1
    for name, values in columns.items():
        made[name] = values
    return made


def ready(rate: int = 500_000, **settings) -> SimulatedInstrument:
    """An instrument set up for a plan, with its shutter open and a lease of a minute."""
    instrument = SimulatedInstrument(phantoms.yarn(0), **settings)
    instrument.begin(PlanSampling(64, 8000, rate))
    instrument.open()
    instrument.permit(60_000_000, 0)
    return instrument


def calls(monkeypatch, part: object, name: str) -> list[tuple]:
    """Note every call of a part's method."""
    made, method = [], getattr(part, name)
    monkeypatch.setattr(part, name, lambda *given: made.append(given) or method(*given))
    return made


def run(instrument: SimulatedInstrument, until: int, step: int = 1_000, start: int = 0) -> list:
    return [taken for now in range(start, until, step) for taken in instrument.poll(now)]


def test_points_of_one_wavelength_are_one_block_of_the_hardwares_own_triggers(monkeypatch):
    instrument = ready()
    armed = calls(monkeypatch, instrument.digitiser, "arm")
    fired = calls(monkeypatch, instrument.excitation, "fire")
    instrument.queue_points(0, points(40, averages=3), 0)
    taken = run(instrument, 400_000)
    assert [each.point for each in taken] == list(range(40))
    assert all(each.averages == 3 for each in taken)
    assert [given[0] for given in armed] == [given[0] for given in fired] == [120], "one call for 120 shots"


def test_a_block_ends_where_the_wavelength_changes_and_is_one_point_for_a_galvo_that_cannot_step(monkeypatch):
    instrument = ready()
    armed = calls(monkeypatch, instrument.digitiser, "arm")
    instrument.queue_points(0, points(9, wavelength=[1_548_000] * 4 + [1_549_000] * 5), 0)
    assert [each.wavelength for each in run(instrument, 100_000)] == [1_548_000] * 4 + [1_549_000] * 5
    assert [given[0] for given in armed] == [4, 5]
    instrument.galvo.steps_by_trigger = False
    armed.clear()
    instrument.queue_points(9, points(4), 100_000)
    assert len(run(instrument, 200_000, start=100_000)) == 4
    assert [given[0] for given in armed] == [1, 1, 1, 1]


def test_instrument_block_records_equal_single_shots_at_any_poll_rate():
    """The truth of each A-line from point and shot number alone; a look each 50 µs or 150 ms finds the same."""
    where = points(30, averages=1, y=np.arange(30) * -70_000)
    often, seldom = ready(), ready()
    for instrument in (often, seldom):
        instrument.queue_points(0, where, 0)
    one, other = run(often, 150_000, step=50), run(seldom, 600_000, step=150_000)
    assert len(one) == len(other) == 30
    for first, second in zip(one, other, strict=True):
        assert np.array_equal(first.samples, often.measure(where[first.point], first.shot).samples)
        assert np.array_equal(first.samples, second.samples)
        assert (first.fire_time, first.shot) == (second.fire_time, second.shot)


def test_instrument_fires_no_pulse_after_permission_expires_without_poll():
    instrument = ready()
    instrument.queue_points(0, points(60, averages=5), 0)
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


def test_instrument_stop_keeps_complete_averages_and_discards_partial():
    instrument = ready()
    instrument.queue_points(0, points(10, averages=4), 0)
    taken = run(instrument, 21_000)
    instrument.stop(21_000)
    taken += instrument.poll(21_000)
    shots = instrument.shots()
    assert 8 <= shots < 12
    assert len(taken) == shots // 4
    assert instrument.next_due(24_000) is None
    run(instrument, 100_000, start=24_000)
    assert instrument.shots() == shots


def test_instrument_sweep_is_nonblocking_and_returns_result_once():
    instrument = SimulatedInstrument(phantoms.yarn(0), seed=3, response=Response(nonlinear=True))
    wavelengths = np.linspace(1_546_000, 1_554_000, 81).round().astype(np.int64)
    instrument.sweep(1_000_000, -2_000_000, wavelengths, 0)
    now, levels = 0, None
    while levels is None:
        levels = instrument.sweep_result(now)
        due = instrument.next_due(now)
        assert levels is not None or due is not None
        now = max(now + 1, due or 0)
    truth = instrument.recorder.film.dc_level(1_000_000, -2_000_000, wavelengths.astype(float))
    assert levels == pytest.approx(truth, abs=0.51)
    assert now > 80 * 200
    assert instrument.sweep_result(now) is None, "told once"


PARTS = {
    "galvo": ("start_path", FAULT_GALVO),
    "laser": ("tune", FAULT_LASER),
    "digitiser": ("arm", FAULT_DIGITISER),
    "excitation": ("fire", FAULT_EXCITATION),
    "shutter": ("interlock_closed", FAULT_GUARD),
}


@pytest.mark.parametrize("part", PARTS)
def test_instrument_part_exception_raises_fault_of_that_part(part, monkeypatch):
    instrument = ready()
    name, fault = PARTS[part]

    def fail(*given: object) -> None:
        raise ConnectionResetError("no answer on the bus")

    monkeypatch.setattr(getattr(instrument, part), name, fail)
    instrument.queue_points(0, points(3), 0)
    act = instrument.interlock_closed if part == "shutter" else partial(run, instrument, 10_000)
    with pytest.raises(InstrumentError, match="no answer on the bus") as caught:
        act()
    assert caught.value.fault == fault


def test_a_laser_that_cannot_wait_for_the_gate_it_claims_is_a_fault_of_the_laser(monkeypatch):
    instrument = ready()
    monkeypatch.delattr(type(instrument.excitation), "fire_at_gate")
    flagged = points(3)
    flagged["flags"] |= FLAG_GATE
    instrument.queue_points(0, flagged, 0)
    with pytest.raises(InstrumentError, match="fire_at_gate") as caught:
        run(instrument, 10_000)
    assert caught.value.fault == FAULT_EXCITATION


def test_a_digitiser_that_misses_a_trigger_is_a_fault_and_no_shot_is_counted_to_the_wrong_point(monkeypatch):
    instrument = ready()
    trigger, count = instrument.digitiser.trigger, iter(range(1_000))
    monkeypatch.setattr(instrument.digitiser, "trigger", lambda *given: trigger(*given) if next(count) != 5 else None)
    instrument.queue_points(0, points(4, averages=4), 0)
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
    instrument.queue_points(0, points(4, averages=averages), 0)
    with pytest.raises(InstrumentError, match="32 samples") as caught:
        run(instrument, 400_000)
    assert caught.value.fault == FAULT_DIGITISER


class Real(Bench):
    """A bench whose hardware is the simulator's apparatus."""

    def boot(self, boot: int) -> Device:
        self.instrument = SimulatedInstrument(phantoms.yarn(0))
        return Device(self.instrument, boot=boot, now=self.device_now, **self.options)

    def upload(self, count: int = 50, *, averages: int = 1, **columns) -> WirePlan:
        plan = WirePlan(points(count, averages=averages, **columns), 64, 8000, 500_000)
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
    assert bench.instrument.shots() == 6 == bench.device.ring.used


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
    with pytest.raises((RequestRejected, fabry_perot.LinkLost), match=reason):
        call.result()
    assert (bench.device.state in (DeviceState.ESTOP, DeviceState.FAULT)) is (end != "new session")


def test_average_with_out_of_range_pulse_energy_is_flagged_misfire():
    """Four pulses of 1, 1, 0.4 and 1.6 of nominal are 1.0 in the mean."""

    def line(*energies: int) -> int:
        records = [TriggerRecord(np.zeros(4, np.int16), 1.0, 0, energy=energy) for energy in energies]
        return average_shots(0, records, (8_000, 12_000)).quality

    assert line(10_000, 10_000, 4_000, 16_000) == MISFIRE
    assert line(8_000, 12_000) == 0
    assert average_shots(0, [TriggerRecord(np.zeros(4, np.int16), 1.0, 0, energy=1)]).quality == 0, (
        "a laser that says no range"
    )


def test_scanner_flags_out_of_range_pulses_and_reports_nominal_energy():
    settings = {"energy_jitter": 0.3, "repeat": 0, "speed": 20, "seed": 1}
    with launch(**settings) as simulator, fabry_perot.connect(simulator.url) as scanner:
        known = scanner.capabilities
        assert (known.pulse_energy, known.energy_range) == (pytest.approx(20e-3), (0.5, 1.5))
        scanner.upload(np.zeros((150, 2)), samples=16, sampling_interval=8e-9, pulse_rate=500.0)
        scanner.start(scanner.arm())
        lines = []
        for batch in scanner.alines():
            lines += batch
            scanner.acknowledge(batch[-1])
    energies = np.array([line.energy for line in lines])
    flagged = np.array([bool(line.quality & MISFIRE) for line in lines])
    assert 3 < flagged.sum() < 60
    np.testing.assert_array_equal(flagged, (energies < 0.5) | (energies > 1.5))
