"""The parts of the example of a lab's computer, against the laser's own process and the made-up table."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path as File

import numpy as np
import pytest

pytest.importorskip("pyvisa_py", reason="needs PyVISA: pip install './driver[lab]'")
EXAMPLE = File(__file__).parents[2] / "driver" / "examples" / "lab-pc"
sys.path.insert(0, str(EXAMPLE))

import scpi_laser  # noqa: E402
from bench.cards import Cards, DigitiserCard  # noqa: E402
from bench.table import DELAY, GATE_EDGES, GATE_PERIOD, OpticalTable, calibration_marks, film_place  # noqa: E402
from daq_parts import CounterGatedLaser, DaqGalvo, DigitalLineShutter  # noqa: E402
from ring_digitiser import RingDigitiser  # noqa: E402
from scpi_laser import ScpiLaser  # noqa: E402

import fabry_perot  # noqa: E402
from fabry_perot.hardware import BeamPath, ComposedInstrument, GalvoCalibration, InstrumentError, PlanSampling  # noqa: E402
from fabry_perot.hardware.composed import FAULT_GALVO, FAULT_LASER  # noqa: E402
from fabry_perot.wire.constants import FLAG_GATE  # noqa: E402
from fabry_perot.wire.messages import POINT  # noqa: E402
from fabry_perot.wire.states import DeviceState  # noqa: E402


@contextmanager
def laser_process(port: int = 0, tuning: float = 0.05) -> Iterator[tuple[str, subprocess.Popen]]:
    """Run a laser in a process of its own, which tunes for so many seconds; its VISA name, and the process."""
    command = [sys.executable, str(EXAMPLE / "bench" / "laser.py"), "--port", str(port), "--tuning", str(tuning)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process.stdout.readline().strip(), process
        finally:
            process.kill()


@pytest.fixture(scope="module")
def visa() -> Iterator[str]:
    with laser_process() as (name, _):
        yield name


def table_of(visa: str) -> OpticalTable:
    _, host, port, _ = visa.split("::")
    return OpticalTable((host, int(port)))


@pytest.fixture
def table(visa) -> Iterator[OpticalTable]:
    with closing(table_of(visa)) as table:
        yield table


@pytest.fixture
def laser(visa) -> Iterator[ScpiLaser]:
    with closing(ScpiLaser(visa)) as laser:
        yield laser


@pytest.fixture
def lab(laser, table) -> ComposedInstrument:
    return lab_of(laser, table)


def lab_of(laser: ScpiLaser, table: OpticalTable) -> ComposedInstrument:
    cards = Cards(table)
    galvo = DaqGalvo(cards, "Dev1", GalvoCalibration.fit(*calibration_marks()))
    return ComposedInstrument(
        galvo=galvo,
        laser=laser,
        digitiser=RingDigitiser(
            DigitiserCard(table),
            lambda: (galvo.positions, laser.wavelength),
            metres_per_pascal=table.shift,
            delay=DELAY,
        ),
        excitation=CounterGatedLaser(cards, "Dev1", edges=GATE_EDGES),
        shutter=DigitalLineShutter(cards, "Dev1"),
    )


def now() -> int:
    return round(1e6 * time.monotonic())


def until(done: Callable[[], object]) -> None:
    limit = time.monotonic() + 60
    while not done():
        assert time.monotonic() < limit
        time.sleep(1e-3)


def test_laser_tune_is_nonblocking_and_reports_completion():
    with laser_process(tuning=1.0) as (visa, _), closing(table_of(visa)) as table, closing(ScpiLaser(visa)) as laser:
        assert laser.limits()["wavelength_pm"] == [1_545_000, 1_555_000]
        laser.tune(1_552_345, now())
        assert abs(table.light() - 1_552_345e-12) > 1e-15, "it tunes for a second"
        until(lambda: laser.tuned(now()))
        assert table.light() == pytest.approx(1_552_345e-12, abs=1e-15), "what comes out of the fibre when it says so"


def test_laser_parameters_are_set_and_read_back(laser):
    laser.configure("interrogation_uw", 500)
    assert laser.parameters() == {"interrogation_uw": 500}


def test_laser_rejected_command_raises_laser_fault_with_device_message(lab):
    lab.laser.tune(1_600_000, now())
    with pytest.raises(InstrumentError, match=r"-222,.Data out of range; 1600\.0000NM") as raised:
        lab._aimed(now())
    assert raised.value.fault == FAULT_LASER


def test_the_card_steps_the_mirrors_through_places_of_the_film_and_the_records_know_where(lab, table):
    """A block of points on the calibrated film, each with its shots, by triggers alone."""
    points = np.zeros(12, POINT)
    points["x"], points["y"] = np.linspace(-5e6, 5e6, 12), np.linspace(4e6, -3e6, 12)
    points["averages"], points["wavelength"] = 2, 1_550_000
    lab.begin(PlanSampling(64, 8_000, 500_000))
    lab.queue_points(0, points, now())
    lab.open()
    lab.permit(now() + 60_000_000, now())
    seen, taken = [], []
    signal = table.signal
    table.signal = lambda x, y, *rest: seen.append((x, y)) or signal(x, y, *rest)
    until(lambda: taken.extend(lab.poll(now())) or len(taken) == 12)
    lab.stop(now())
    wanted = np.repeat(np.column_stack([points["x"], points["y"]]) * 1e-9, 2, axis=0)
    np.testing.assert_allclose(seen, wanted, atol=5e-6)
    assert [each.averages for each in taken] == [2] * 12
    assert {each.time_zero for each in taken} == {round(DELAY * 1e10)}
    assert lab.shots() == 24


def test_lab_fires_no_pulse_after_permission_expires_without_poll(lab, table):
    points = np.zeros(60, POINT)
    points["averages"], points["wavelength"] = 100, 1_550_000
    lab.begin(PlanSampling(64, 8_000, 1_000_000))
    lab.queue_points(0, points, now())
    lab.open()
    ends = 0

    def fires() -> bool:
        nonlocal ends
        if now() > ends:  # also where a busy machine let a permission lapse before the first pulse
            ends = now() + 300_000
            lab.permit(ends, now())
        return bool(lab.poll(now()) or lab.shots())

    until(fires)
    until(lambda: now() > ends + 100_000)
    fired = lab.shots()
    assert 0 < fired <= 301
    assert lab.last_shot() < ends
    until(lambda: now() > ends + 150_000)
    assert lab.shots() == fired
    lab.close()
    assert not lab.shutter_open()


@pytest.mark.parametrize("renewed", [False, True], ids=["permitted", "permission lapsed and renewed"])
def test_gated_point_fires_from_gate_edge_despite_permission_lapse(lab, table, renewed):
    points = np.zeros(2, POINT)
    points["averages"], points["wavelength"], points["flags"] = 3, 1_550_000, FLAG_GATE
    assert lab.capabilities()["gate"]
    lab.begin(PlanSampling(64, 8_000, 200_000))
    lab.queue_points(0, points, now())
    lab.open()
    taken: list = []
    until(lambda: 0.02 < table.clock() % GATE_PERIOD < GATE_PERIOD - 0.1)
    lab.permit(now() + (1_000 if renewed else 60_000_000), now())
    until(lambda: taken.extend(lab.poll(now())) or table.train or taken)
    if renewed:
        edge = table.next_edge()
        until(lambda: taken.extend(lab.poll(now())) or table.clock() > edge + 0.03)
        assert not taken
        lab.permit(now() + 60_000_000, now())
    until(lambda: taken.extend(lab.poll(now())) or len(taken) == 2)
    first = np.array([each.fire_time for each in taken]) * 1e-6 - 2 / 200
    assert np.abs((first + GATE_PERIOD / 2) % GATE_PERIOD - GATE_PERIOD / 2).max() < 4e-3
    assert [each.averages for each in taken] == [3, 3]


def test_open_interlock_keeps_shutter_closed(lab, table):
    table.interlock = False
    lab.open()
    assert not lab.shutter_open()
    assert not lab.interlock_closed()


def test_a_table_that_would_have_to_wait_is_refused_as_a_fault_of_the_galvo(lab):
    points = np.zeros(3, POINT)
    points["settle"], points["wavelength"] = 5, 1_550_000
    lab.begin(PlanSampling(64, 8_000, 500_000))
    lab.queue_points(0, points, now())
    with pytest.raises(InstrumentError, match="steps_by_trigger") as raised:
        lab.poll(now())
    assert raised.value.fault == FAULT_GALVO
    lab.galvo.steps_by_trigger = False
    one = np.ones(1, np.int64)
    lab.galvo.start_path(BeamPath(one, one, one, 500 * one), now())
    assert film_place(lab.galvo._volts[None])[0] == pytest.approx([1e-9, 1e-9], abs=5e-6)


@pytest.mark.long
def test_scpi_laser_power_cycle_is_reopened_and_reconfigured(monkeypatch):
    monkeypatch.setattr(scpi_laser, "AGAIN", 0.0)
    with laser_process() as (visa, process), closing(ScpiLaser(visa)) as laser:
        laser.tune(1_552_345, now())
        process.kill()
        process.wait()
        for _ in range(2):
            with pytest.raises(ConnectionError, match="the laser TCPIP::"):
                laser.parameters()
        with laser_process(int(visa.split("::")[2])):
            assert laser.parameters() == {"interrogation_uw": 1000}
            assert laser.wavelength == 1_550_000, "what it is at after it was off"
            assert laser.tuned(now())
            laser.tune(1_548_000, now())
            until(lambda: laser.tuned(now()))
            assert laser._query(":POW:STAT?") == "1"


@pytest.mark.long
def test_host_reads_the_fault_of_an_instrument_in_its_words_and_goes_on_once_it_is_back(monkeypatch):
    monkeypatch.setattr(scpi_laser, "AGAIN", 0.0)
    with laser_process() as (visa, process):
        _, host, port, _ = visa.split("::")
        with closing(OpticalTable((host, int(port)))) as table:
            laser = ScpiLaser(visa)
            with fabry_perot.connect(lab_of(laser, table)) as scanner:
                assert scanner.statistics()["fault_text"] == ""
                process.kill()
                process.wait()
                with pytest.raises(fabry_perot.RequestRejected, match="hardware-fault"):
                    scanner.statistics()
                answer = scanner.statistics()
                assert (answer["fault"], answer["state"]) == (FAULT_LASER, DeviceState.FAULT)
                assert visa in answer["fault_text"]
                with laser_process(int(port)):
                    scanner.clear_fault("a person")
                    assert scanner.state == "safe_hold"
                    assert scanner.statistics()["interrogation_uw"] == 1000
