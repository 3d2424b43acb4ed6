"""Calibrations against what they are to find: mirrors that bend the field, a pulse in a record."""

from __future__ import annotations

import numpy as np
import pytest

from fabry_perot.hardware import GalvoCalibration, time_zero


def pincushion(volts: np.ndarray) -> np.ndarray:
    """Two mirrors, one behind the other, and an f-θ lens that is none: places in m."""
    u, v = np.radians(4 * np.asarray(volts)).T
    turned = np.column_stack([40e-3 * np.tan(u) / np.cos(v), 40e-3 * np.tan(v)])
    angle = 0.02
    return turned @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) + [2e-4, -1e-4]


def grid(count: int, reach: float = 2.4) -> np.ndarray:
    axis = np.linspace(-reach, reach, count)
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize(("degree", "error"), [(1, 200e-6), (3, 3e-6)])
def test_the_beam_goes_where_it_is_sent(degree, error, tmp_path):
    """At places between the marks, where nothing was fitted; and a file says the same."""
    made = GalvoCalibration.fit(pincushion(grid(7)), grid(7), degree)
    made.save(tmp_path / "galvo.json")
    kept = GalvoCalibration.load(tmp_path / "galvo.json")
    wanted = pincushion(grid(10, 2.3))
    reached = pincushion(kept.volts(wanted))
    missed = np.linalg.norm(reached - wanted, axis=1)
    assert error / 30 < np.sqrt((missed**2).mean()) < error
    assert 0.3 < made.residual / np.sqrt((missed**2).mean()) < 3, "the residual says how good it is"
    assert np.linalg.norm(kept.metres(kept.volts(wanted)) - wanted, axis=1).max() < 3 * error
    assert kept.residual == made.residual


def test_a_mark_that_was_taken_for_its_neighbour_shows_in_the_residual():
    volts = grid(7)
    places = pincushion(volts)
    places[24] = places[25]
    assert GalvoCalibration.fit(places, volts, 3).residual > 100e-6


def test_marks_that_say_too_little_are_refused():
    with pytest.raises(ValueError, match="11 marks"):
        GalvoCalibration.fit(pincushion(grid(3)), grid(3), 3)
    line = np.column_stack([np.linspace(-1, 1, 20), np.linspace(-1, 1, 20)])
    with pytest.raises(ValueError, match="line"):
        GalvoCalibration.fit(pincushion(line), line, 1)


@pytest.mark.parametrize("sign", [1, -1])
def test_time_zero_is_found_from_a_pulse_in_the_record_to_a_fraction_of_a_sample(sign):
    """A step of half a sample's rise, drawn finely and averaged; in noise, and with a record begun earlier."""
    interval, pulse = 8e-9, 60.3 * 8e-9
    times = np.arange(256) * interval
    record = sign * 100 / (1 + np.exp(-(times - pulse) / (0.4 * interval))) * np.exp(-(times - pulse).clip(0) / 3e-7)
    record += np.random.default_rng(0).normal(5, 0.5, 256)
    assert time_zero(record, interval) == pytest.approx(-pulse, abs=0.5 * interval)
    assert time_zero(record, interval, earlier=600e-9) == pytest.approx(600e-9 - pulse, abs=0.5 * interval)


def test_a_record_without_a_pulse_has_no_time_zero():
    with pytest.raises(ValueError, match="no pulse"):
        time_zero(np.random.default_rng(0).normal(0, 1, 512), 8e-9)
