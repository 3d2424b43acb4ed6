"""Several interrogation beams: A-lines of a shot together, from the wire to a host's account."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from driver_bench import CAPABILITIES
from driver_collected import collect
from driver_line import outcomes

import fabry_perot
from fabry_perot.device.scan import Scan
from fabry_perot.errors import FrameError, PlanInvalid
from fabry_perot.hardware import InstrumentError, PlanSampling
from fabry_perot.hardware.composed import FAULT_DIGITISER
from fabry_perot.host import WirePlan
from fabry_perot.host.capabilities import Capabilities
from fabry_perot.host.shot_accounting import ShotLedger
from fabry_perot.simulator import launch, phantoms
from fabry_perot.simulator.instrument import SimulatedInstrument
from fabry_perot.simulator.options import pattern
from fabry_perot.simulator.signal_path import peak_pressure
from fabry_perot.wire.messages import POINT

COMMON = {"samples": 200, "sampling_interval": 8e-9, "pulse_rate": 500.0}
SIX = {"beams": "3x2", "beam_spacing": 0.7e-3}
OFFSETS = np.array([[0.7e-3 * column, 0.7e-3 * row] for row in range(2) for column in range(3)])


def places(count: int) -> np.ndarray:
    return np.random.default_rng(5).uniform(-3e-3, 3e-3, (count, 2)).round(6)


def test_every_beam_records_the_pressure_where_it_is_of_the_one_pulse_of_its_place():
    """Closed form: the phantom's pressure at place + offset, times the pulse's energy, plus this beam's own noise."""
    where, seed = places(9), 3
    with launch(seed=seed, speed=20, **SIX) as simulator, fabry_perot.connect(simulator.url) as scanner:
        np.testing.assert_allclose(scanner.capabilities.beam_offsets, OFFSETS, atol=1e-15)
        scanner.upload(where, beams=6, **COMMON)
        scanner.start(scanner.arm())
        lines, report = collect(scanner), scanner.report()
    assert [line.point for line in lines] == list(range(54))
    shots = np.array([line.shot for line in lines]).reshape(9, 6)
    assert (shots == shots[:, :1]).all()
    assert np.unique(shots).size == 9
    assert report.fired == 9 + report.wasted, "one pulse a place, not one a beam"
    assert (report.points, report.stored, report.is_balanced) == (54, 54, True)
    balls, times = phantoms.yarn(seed), np.arange(200) * 8000e-12
    rms = peak_pressure(balls, 1500.0) * 10 ** (-30.0 / 20)
    for line in lines[::7]:
        beam, position = line.point % 6, np.rint((where[line.point // 6] + OFFSETS[line.point % 6]) * 1e9) * 1e-9
        random = np.random.default_rng([seed, line.shot])
        energy = 1 + 0.01 * random.standard_normal()
        random = np.random.default_rng([seed, line.shot, beam]) if beam else random
        signal = phantoms.pressure(balls, position, times, 1500.0)[0].astype(float) * energy
        signal += rms * random.standard_normal(200, dtype=np.float32).astype(float)
        np.testing.assert_array_equal(line.samples, np.rint(signal / line.scale).astype(np.int16))


def test_a_host_that_knows_of_no_beams_has_a_scanner_of_one():
    where = places(7)
    with launch(speed=20, **SIX) as simulator, fabry_perot.connect(simulator.url) as scanner:
        scanner.upload(where, **COMMON)
        scanner.start(scanner.arm())
        lines = collect(scanner)
    with launch(speed=20) as simulator, fabry_perot.connect(simulator.url) as scanner:
        scanner.upload(where, **COMMON)
        scanner.start(scanner.arm())
        alone = collect(scanner)
    assert [line.point for line in lines] == list(range(7))
    assert all((line.samples == other.samples).all() for line, other in zip(lines, alone, strict=True))


def test_a_plan_that_starts_between_beams_fires_the_place_and_makes_the_missing_a_lines():
    with launch(speed=20, **SIX) as simulator, fabry_perot.connect(simulator.url) as scanner:
        scanner.upload(places(4), beams=6, start=10, averages=2, **COMMON)
        scanner.start(scanner.arm())
        lines, report = collect(scanner), scanner.report()
    assert [line.point for line in lines] == list(range(10, 24))
    assert report.fired == 2 * 3 + report.wasted
    assert report.is_balanced


def test_beams_that_a_scanner_has_not_are_refused_by_name():
    with launch(**SIX) as simulator, fabry_perot.connect(simulator.url) as scanner:
        for count in (0, 7):
            with pytest.raises(PlanInvalid, match="beams"):
                scanner.upload(places(3), beams=count, **COMMON)


def test_the_account_of_a_reboot_counts_pulses_by_place():
    """Four beams, two shots a place; the device booted after 3 places and a shot at a fourth, with 9 A-lines here."""
    plan = WirePlan.from_metres(places(6), samples=64, sampling_interval=8e-9, pulse_rate=50.0, averages=2, beams=4)
    assert plan.length == 24
    ledger = ShotLedger()
    ledger.record_start(boot=1, start=0, laser_shots=100, wasted=0)
    ledger.record_reboot(plan, 2, 9, 107, 0)
    assert (ledger.refired, ledger.refired_places) == ([9, 10, 11], 1)
    assert ledger.wasted(0) == 1
    ledger.record_reboot(plan, 3, 9, 109, 0)  # from A-line 9 on: its place is fired on as a whole, and is lost again
    assert (ledger.refired, ledger.refired_places) == ([9, 10, 11] * 2, 2)


def test_a_scanner_that_restarts_in_mid_plan_ends_with_every_a_line_and_a_balanced_account():
    where = places(40)
    with launch(speed=5, ring=64, **SIX) as simulator, fabry_perot.connect(simulator.url) as scanner:
        scanner.upload(where, beams=6, **COMMON)
        scanner.start(scanner.arm())
        got, asked = [], False
        while len(got) < 240:
            try:
                for batch in scanner.alines():
                    got += [line.point for line in batch]
                    scanner.acknowledge(batch[-1])
                    if len(got) > 60 and not asked:
                        asked = True
                        simulator.send_command("reboot")
            except (fabry_perot.LeaseExpired, fabry_perot.DeviceRestarted):
                scanner.resume()
        report = scanner.report()
    assert got == list(range(240))
    assert report.restarts == 1
    assert report.is_balanced, report


def test_capabilities_without_a_place_for_each_beam_are_garbled():
    with pytest.raises(FrameError, match="beams"):
        Capabilities.from_map({**CAPABILITIES, "lease_cap_us": 1, "beams": 3, "beam_offsets_nm": [[0, 0], [5, 5]]})


def test_records_that_are_not_of_the_beam_that_is_due_are_a_fault_of_the_digitiser():
    instrument = SimulatedInstrument(phantoms.yarn(0), beams=pattern("3", 1e-3))
    instrument.boot(0)
    instrument.begin(PlanSampling(64, 8_000, 500_000, 3))
    points = np.zeros(2, POINT)
    points["averages"] = 1
    instrument.queue_points(0, points, 1)
    instrument.open()
    instrument.permit(1 << 40, 1)
    instrument.poll(1)
    records = instrument.digitiser.records
    instrument.digitiser.records = lambda now: records(now)[::-1]
    with pytest.raises(InstrumentError, match="beam 2 where beam 0 is due") as raised:
        instrument.poll(50_000)
    assert raised.value.fault == FAULT_DIGITISER


@pytest.fixture
def of_three(monkeypatch):
    monkeypatch.setitem(CAPABILITIES, "beams", 3)
    monkeypatch.setitem(CAPABILITIES, "beam_offsets_nm", [[0, 0], [5, 0], [0, 5]])


def test_conformance_three_beam_device_passes_beam_scenarios(of_three):
    assert outcomes("beams", "multi_beam_order", "full_ring", ring=15) == dict.fromkeys(
        ["beams", "multi_beam_order", "full_ring"], ""
    )


def _taken(change):
    """Break what the device makes of what the hardware took."""

    def apply(patch):
        original = Scan._collect

        def collect(self, now):
            instrument, poll = self._instrument, self._instrument.poll
            instrument.poll = lambda now: change(self, poll(now))
            try:
                original(self, now)
            finally:
                instrument.poll = poll

        patch.setattr(Scan, "_collect", collect)

    return apply


def _of_a_shot_each(scan, taken):
    return [replace(each, shot=each.shot + each.beam) for each in taken]


MUTANTS = {
    "a shot a beam": (_taken(_of_a_shot_each), "multi_beam_order"),
    "the first beam alone": (_taken(lambda scan, taken: [each for each in taken if not each.beam]), "multi_beam_order"),
    "any number of beams": (lambda patch: patch.setitem(CAPABILITIES, "beams", 5), "beams"),
}


@pytest.mark.mutants
@pytest.mark.parametrize("name", MUTANTS)
def test_a_mutant_fails_the_scenario_made_for_it(name, of_three, monkeypatch):
    apply, scenario = MUTANTS[name]
    apply(monkeypatch)
    assert outcomes(scenario, ring=15)[scenario].startswith("expected: ")
