"""What the simulated digitiser records, frame after frame."""

import numpy as np

from fabry_perot.hardware import PlanSampling
from fabry_perot.simulator import phantoms, signal_path

PLACES = [(x, y) for x in range(-2_000_000, 2_000_001, 500_000) for y in (-1_000_000, 0, 1_000_000)]


def test_recorder_computes_pressure_once_per_position_across_frames(monkeypatch):
    asked = []

    def counted(balls, where, *args):
        asked.append(len(where))
        return phantoms.pressure(balls, where, *args)

    monkeypatch.setattr(signal_path, "pressure", counted)
    balls = phantoms.yarn(0)
    made = signal_path.SignalPath(balls, noise_db=300, energy_jitter=0.0)
    asked.clear()
    made.begin(PlanSampling(256, 8000, 50_000))
    for frame in range(3):
        made.prefetch(PLACES)
        for shot, (x, y) in enumerate(PLACES):
            record = made.record(x, y, signal_path.IDLE_LEVEL, frame * len(PLACES) + shot)
            where = np.array([[x * 1e-9, y * 1e-9]])
            clean = phantoms.pressure(balls, where, np.arange(256) * 8e-9, 1500.0)[0]
            assert np.abs(record.samples - clean / made.scale).max() < 1e-3
    assert sum(asked) == len(PLACES)


def test_lines_that_are_too_many_to_keep_are_forgotten_and_computed_again(monkeypatch):
    monkeypatch.setattr(signal_path, "CACHED_POINTS", 2 * signal_path.BLOCK * 256)
    made = signal_path.SignalPath(phantoms.yarn(0), noise_db=300, energy_jitter=0.0)
    made.begin(PlanSampling(256, 8000, 50_000))
    twice = [[made.record(x, y, signal_path.IDLE_LEVEL, 0).samples for x, y in 3 * PLACES] for _ in range(2)]
    assert np.array_equal(twice[0], twice[1])
    assert len(made._lines) <= 2 * signal_path.BLOCK
