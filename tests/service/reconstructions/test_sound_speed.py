"""The speed of sound found is that of the made sound, within the error stated."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from fabry_perot.simulator.phantoms import Balls, pressure, yarn
from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.imaging import Layer, Medium
from steradian.masks import equi_steradian_mask
from steradian.reconstructions.studies import medium_fit
from steradian.reconstructions.studies.medium_fit import MediumFit
from steradian.reconstructions.studies.medium_unknowns import MediumState, Unknown
from steradian.reconstructions.studies.sound_speed_search import SoundSpeedCurve, find_sound_speed, scan_sound_speed
from steradian_benchmarks.sound_speed import scene, search

SIDE, DEPTH, INTERVAL, SAMPLES = 7.2e-3, 2.0e-3, 16e-9, 400


SPEED = Unknown("layer1.sound_speed", 1380.0, 1620.0)


def one_speed(time_zero: float = 0.0, speed: float = 1500.0) -> MediumState:
    return MediumState(Medium([Layer(speed)]), time_zero)


def recording(speed: float, seed: int) -> tuple[Any, np.ndarray]:
    mask = equi_steradian_mask(SIDE, DEPTH, 400)
    balls = yarn(seed, centre=(0.0, 0.0, DEPTH), radius=1.6e-3)
    traces = pressure(balls, mask.positions, np.arange(SAMPLES) * INTERVAL, speed)
    noise = np.random.default_rng(seed).standard_normal(traces.shape) * np.abs(traces).max() * 10**-1.5
    return mask, (traces + noise).astype(np.float32)


def find(speed: float, seed: int, first: float, last: float, steps: int, **options: Any) -> SoundSpeedCurve:
    mask, traces = recording(speed, seed)
    return find_sound_speed(
        traces, mask.positions, np.linspace(first, last, steps), sampling_interval=INTERVAL, aperture=SIDE,
        weights=mask.weights, **options,
    )  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize(("speed", "seed"), [(1400.0, 0), (1463.0, 1), (1540.0, 2), (1600.0, 3)])
def test_the_speed_is_found_within_three_thousandths_at_30_db(speed: float, seed: int) -> None:
    curve = find(speed, seed, 1380, 1620, 13, standard_error=False, criterion="sharpness")
    assert curve.best == pytest.approx(speed, rel=0.003)
    assert not curve.at_edge
    assert list(curve.sound_speeds) == sorted(curve.sound_speeds)
    assert max(curve.sharpness) > 1.02 * curve.sharpness[0]


@pytest.mark.long
def test_sound_speed_standard_error_bounds_actual_error() -> None:
    curve = find(1500.0, 4, 1460, 1540, 5, criterion="sharpness")
    assert curve.standard_error is not None
    assert 0 < curve.standard_error < 5
    assert abs(curve.best - 1500.0) < 4 * curve.standard_error + 1.5


def test_sound_speed_maximum_at_range_end_is_flagged_as_edge() -> None:
    curve = find(1500.0, 0, 1300, 1420, 4, criterion="sharpness")
    assert curve.at_edge
    assert (curve.best, curve.standard_error) == (1420.0, None)


@pytest.mark.long
def test_a_recording_gets_its_curve_as_json_and_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, few in (("ROUNDS", 1), ("SUPPORT_STEPS", 2), ("STEPS", 2)):
        monkeypatch.setattr(medium_fit, name, few)
    p = np.random.default_rng(0).standard_normal((64, 16, 16)).astype(np.float32)
    file = tmp_path / "scan.npz"
    np.savez(file, p=p, dt=20e-9, dx=100e-6)
    told: list[tuple[str, int, int]] = []
    curve = scan_sound_speed(
        file, tmp_path / "out", first=1450, last=1550, steps=3, progress=lambda *about: told.append(about)
    )
    written = json.loads((tmp_path / "out" / "sound-speed.json").read_text())
    assert written["best"] == curve.best
    assert len(written["sound_speeds"]) == len(written["sharpness"])
    assert (tmp_path / "out" / "sound-speed.png").stat().st_size > 5000
    assert told[0][0] == "sound speed"
    with pytest.raises(Cancelled):
        scan_sound_speed(file, tmp_path / "out", cancelled=lambda: True)
    with pytest.raises(InvalidInput, match="first, last"):
        scan_sound_speed(file, tmp_path / "out", first=1600, last=1500)
    with pytest.raises(InvalidInput, match="steps"):
        scan_sound_speed(file, tmp_path / "out", steps=2)
    from steradian.cli.app import app

    result = CliRunner().invoke(app, ["sound-speed", str(file), str(tmp_path / "cli"), "--steps", "3"])
    assert result.exit_code == 0, result.output
    assert "m/s" in result.output
    assert (tmp_path / "cli" / "sound-speed.json").exists()


@pytest.mark.parametrize(
    ("kind", "side", "noise", "delay", "seed"),
    [
        pytest.param("points", 4e-3, 30.0, 0.0, 901, marks=pytest.mark.nightly),
        pytest.param("points", 8e-3, 20.0, 0.6e-6, 902, marks=pytest.mark.long),
        pytest.param("vessels", 8e-3, 30.0, 0.0, 903, marks=pytest.mark.long),
        pytest.param("smooth", 10e-3, 30.0, 0.6e-6, 904, marks=pytest.mark.long),
    ],
)
def test_find_sound_speed_of_small_apertures_and_smooth_objects_holds_the_truth_in_three_errors(
    kind: str, side: float, noise: float, delay: float, seed: int
) -> None:
    true, curve = search(kind, side, noise, delay, seed)
    assert curve.standard_error is not None
    assert curve.standard_error < 0.003 * true
    assert abs(curve.best - true) < 3 * curve.standard_error


@pytest.mark.parametrize(
    ("side", "seed"),
    [pytest.param(4e-3, 905, marks=pytest.mark.nightly), pytest.param(8e-3, 906, marks=pytest.mark.long)],
)
def test_speed_fit_of_a_record_with_a_wrong_begin_is_off_by_the_trade_stated(side: float, seed: int) -> None:
    shift, interval, samples = 20e-9, 20e-9, 300
    axis = (np.arange(24) + 0.5) / 24 - 0.5
    positions = side * np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    traces = pressure(scene("points", side, seed), positions, np.arange(samples) * interval, 1500.0)
    right, wrong = (
        MediumFit(traces, positions, interval, side, one_speed(zero), [SPEED], None, lambda: None).find(one_speed(zero))
        for zero in (0.0, shift)
    )
    assert right.values[0] == pytest.approx(1500.0, rel=0.002)
    assert right.speed_per_delay is not None
    assert wrong.values[0] - right.values[0] == pytest.approx(right.speed_per_delay * shift, rel=0.25)


@pytest.mark.long
@pytest.mark.parametrize("depth_times", [(1e-6, 3e-6), (0.8e-6, 2.4e-6), (0.64e-6, 3.2e-6)])
def test_speed_fit_of_depths_at_whole_samples_has_the_same_slices_at_every_speed(
    depth_times: tuple[float, float],
) -> None:
    mask, traces = recording(1500.0, 0)
    fit = MediumFit(traces, mask.positions, INTERVAL, SIDE, one_speed(), [SPEED], depth_times, lambda: None)
    states = [one_speed(speed=speed) for speed in np.arange(1380.0, 1620.0, 17.3)]
    assert len({fit.model(state).volume_shape for state in states}) == 1


def test_sound_speed_from_sensor_line_notes_sharpness_criterion() -> None:
    axis = (np.arange(40) - 20) * 0.2e-3
    traces = np.random.default_rng(0).standard_normal((40, 100)).astype(np.float32)
    curve = find_sound_speed(traces, axis, np.linspace(1400, 1600, 3), sampling_interval=20e-9, aperture=8e-3)
    assert "sharpest" in curve.notes[0]


@pytest.mark.long
def test_find_sound_speed_of_three_balls_under_four_millimetres_is_not_biased() -> None:
    axis = (np.arange(40) - 19.5) * 0.1e-3
    positions = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    centres = 1e-3 * np.array([[0.9, -0.5, 2.0], [-1.0, 0.9, 3.0], [0.3, 1.3, 2.6]])
    balls = Balls(centres, np.full(3, 100e-6), np.array([1.0, 0.6, 0.8]))
    traces = pressure(balls, positions, np.arange(200) * 20e-9, 1480.0)
    speeds = np.linspace(1380, 1620, 25)
    curve = find_sound_speed(traces, positions, speeds, sampling_interval=20e-9, aperture=4e-3)
    assert curve.standard_error is not None
    assert curve.standard_error < 3
    assert curve.best == pytest.approx(1480, abs=3)
