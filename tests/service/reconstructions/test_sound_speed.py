"""The speed of sound that makes the image sharpest is the one the sound had."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from fabry_perot.simulator.phantoms import pressure, yarn
from steradian.errors import Cancelled, InvalidInput
from steradian.masks import equi_steradian_mask
from steradian.reconstructions.sound_speed import SoundSpeedCurve, find_sound_speed, scan_sound_speed

SIDE, DEPTH, INTERVAL, SAMPLES = 7.2e-3, 2.0e-3, 16e-9, 400


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


@pytest.mark.parametrize(("speed", "seed"), [(1400.0, 0), (1463.0, 1), (1540.0, 2), (1600.0, 3)])
def test_the_speed_is_found_within_three_thousandths_at_30_db(speed: float, seed: int) -> None:
    curve = find(speed, seed, 1380, 1620, 13, standard_error=False)
    assert curve.best == pytest.approx(speed, rel=0.003)
    assert not curve.at_edge
    assert list(curve.sound_speeds) == sorted(curve.sound_speeds)
    assert max(curve.sharpness) > 1.02 * curve.sharpness[0]


def test_the_standard_error_says_how_far_off_it_is() -> None:
    curve = find(1500.0, 4, 1460, 1540, 5)
    assert curve.standard_error is not None
    assert 0 < curve.standard_error < 5
    assert abs(curve.best - 1500.0) < 4 * curve.standard_error + 1.5


def test_a_maximum_at_the_end_of_the_range_is_said_to_be_one() -> None:
    curve = find(1500.0, 0, 1300, 1420, 4)
    assert curve.at_edge
    assert (curve.best, curve.standard_error) == (1420.0, None)


def test_a_recording_gets_its_curve_as_json_and_picture(tmp_path: Path) -> None:
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
