"""Shots that wait for something else: a heart, a stimulus, at the scanner's gate input."""

from __future__ import annotations

import numpy as np
import pytest

import fabry_perot
from fabry_perot.errors import PlanInvalid
from fabry_perot.hardware import PlanSampling
from fabry_perot.simulator import launch, phantoms
from fabry_perot.simulator.instrument import SimulatedInstrument
from fabry_perot.wire.constants import FLAG_GATE
from fabry_perot.wire.messages import POINT

PERIOD = 70_000
PULSE = 2_000


def fired(flags: np.ndarray, averages: int = 1) -> np.ndarray:
    """Return when (µs) each point was fired on, by a scanner of 500 Hz with an edge each 70 ms."""
    instrument = SimulatedInstrument(phantoms.yarn(0), gate=PERIOD, repeat=1)
    points = np.zeros(len(flags), POINT)
    points["x"], points["flags"], points["averages"] = np.arange(len(flags)) * 50_000, flags, averages
    instrument.boot(0)
    instrument.begin(PlanSampling(64, 8_000, 500_000))
    instrument.queue_points(0, points, 1)
    instrument.open()
    instrument.permit(1 << 40, 1)
    taken, now = [], 1
    while len(taken) < len(points):
        taken += instrument.poll(now)
        now = instrument.next_due(now) or now + 1
    assert [each.point for each in taken] == list(range(len(points)))
    return np.array([each.fire_time for each in taken])


def test_each_gated_point_is_fired_on_right_after_an_edge_of_its_own():
    times = fired(np.full(6, FLAG_GATE))
    assert (times % PERIOD <= PULSE + 2).all(), "the first pulse after the edge"
    assert np.unique(times // PERIOD).size == 6


def test_a_frame_waits_once_and_goes_on_without():
    flags = np.zeros(40, np.uint8)
    flags[[0, 20]] = FLAG_GATE
    times = fired(flags)
    for frame in (times[:20], times[20:]):
        assert frame[0] % PERIOD <= PULSE + 2
        assert np.diff(frame).max() <= PULSE + 2
    assert times[20] // PERIOD > times[19] // PERIOD


def test_the_average_of_a_gated_point_is_taken_from_one_edge_on():
    times = fired(np.full(3, FLAG_GATE), averages=5)
    assert (times % PERIOD >= 4 * PULSE).all()
    assert (times % PERIOD <= 5 * PULSE + 2).all()


@pytest.mark.long
def test_gated_upload_fires_on_gate_or_is_rejected_without_gate_input():
    where = np.column_stack([np.linspace(-1e-3, 1e-3, 30), np.zeros(30)])
    common = {"samples": 64, "sampling_interval": 8e-9, "pulse_rate": 500.0}
    gated = np.arange(30) % 10 == 0
    with launch(gate_rate=2.0, repeat=1, speed=5) as simulator, fabry_perot.connect(simulator.url) as scanner:
        assert scanner.capabilities.gate
        with pytest.raises(PlanInvalid, match="gated"):
            scanner.upload(where, gated=gated[:3], **common)
        scanner.upload(where, gated=gated, **common)
        scanner.start(scanner.arm())
        times = []
        for batch in scanner.alines():
            times += [aline.fire_time_s for aline in batch]
            scanner.acknowledge(batch[-1])
    after = np.array(times) % 0.5
    assert (after[gated] < 0.003).all()
    assert (np.diff(times)[~gated[1:]] < 0.003).all()
    with launch(repeat=1) as simulator, fabry_perot.connect(simulator.url) as scanner:
        assert not scanner.capabilities.gate
        with pytest.raises(PlanInvalid, match="no gate input"):
            scanner.upload(where, gated=True, **common)


@pytest.mark.parametrize(
    "renewed", [PERIOD + 30_000, PERIOD + 6 * PULSE + 1], ids=["before its edge", "in its average"]
)
def test_a_permission_that_lapsed_is_not_made_up_for_off_the_edge(renewed):
    """The hardware's timer ran out before, or within, what an edge began; renewed later, it begins at an edge again."""
    instrument = SimulatedInstrument(phantoms.yarn(0), gate=PERIOD, repeat=1)
    points = np.zeros(2, POINT)
    points["x"], points["flags"], points["averages"] = [0, 50_000], FLAG_GATE, 5
    instrument.boot(0)
    instrument.begin(PlanSampling(64, 8_000, 500_000))
    instrument.queue_points(0, points, 1)
    instrument.open()
    instrument.permit(PERIOD - 10_000 if renewed > PERIOD + 10 * PULSE else PERIOD + 2 * PULSE + 1, 1)
    taken, now = [], 1
    while now < renewed:
        taken += instrument.poll(now)
        now += 1_000
    assert not taken
    instrument.permit(1 << 40, renewed)
    while len(taken) < 2:
        taken += instrument.poll(now)
        now += 1_000
    first = np.array([each.fire_time for each in taken]) - 4 * PULSE
    assert (first % PERIOD <= PULSE + 2).all(), first
    assert [(each.point, each.averages) for each in taken] == [(0, 5), (1, 5)]
