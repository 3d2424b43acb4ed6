"""The spectrum of the image against direct float64 sums: the promise of ``tolerance``."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from steradian.imaging import Volume, direct_spectrum, kaiser_bessel, spectrum_of
from support.flat import flat_reconstruct

SPEED = 1500.0


def scattered(rng: np.random.Generator, count: int, sides: tuple[float, ...]) -> np.ndarray:
    positions = (rng.random((count, len(sides))) - 0.5) * sides
    positions[0] = np.array(sides) / 2  # on the aperture's corner
    positions[-1] = -np.array(sides) / 2
    return positions


def grid(counts: tuple[int, ...], sides: tuple[float, ...], shift: float = 0.0) -> np.ndarray:
    axes = [(np.arange(n) - n // 2 + shift) * X / n for n, X in zip(counts, sides, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(counts))


def error(
    modes: tuple[int, ...],
    samples: int,
    positions: np.ndarray,
    sides: tuple[float, ...],
    steepness: float = 0.9,
    late: float = 0.0,
    **options: Any,
) -> float:
    """Relative l2 error of F on random (j, l), a third of them at the smallest κ and at the Nyquist modes.

    ``late`` is the time of the first sample, in samples; the truth is then that of the record with zeros in front.
    """
    rng = np.random.default_rng(7)
    traces = rng.standard_normal((len(positions), samples))
    weights = (0.5 + rng.random(len(positions))) * np.prod(sides) / len(positions)
    interval = sides[0] / (samples * SPEED) * steepness  # steepness = N_t·Δz/X
    common = {
        "sampling_interval": interval,
        "sound_speed": SPEED,
        "aperture": sides,
        "modes": modes,
        "weights": weights,
        "time_zero": late * interval,
    }
    ahead = max(0, int(np.ceil(late)))
    if ahead:
        options["depth_range"] = (0.0, SPEED * interval * (samples + ahead - 1))
    volume = flat_reconstruct(traces, positions, **common, **options)
    assert isinstance(volume, Volume)
    traces = np.pad(traces, ((0, 0), (ahead, 0)))
    samples, common["time_zero"] = samples + ahead, (late - ahead) * interval
    count = 150
    j = np.stack([rng.integers(-(n // 2), (n - 1) // 2 + 1, count) for n in modes], axis=-1)
    l = rng.integers(1, (samples + 1) // 2, count)  # noqa: E741
    j[:10] = np.sign(j[:10])
    l[:20] = 1 + np.arange(20) % 2
    j[0] = 0
    for i in range(20, 40):
        j[i, i % len(modes)] = -(modes[i % len(modes)] // 2)
    exact = direct_spectrum(traces, positions, j, l, **common)
    found = spectrum_of(volume.values, j, l)
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-5])
@pytest.mark.parametrize(
    ("modes", "samples"),
    [((16, 18), 64), ((17, 15), 63), ((16, 15), 77), ((30,), 128), ((31,), 101)],
    ids=["even", "odd", "mixed", "line-even", "line-odd"],
)
def test_scattered_sensors_keep_the_tolerance(modes: tuple[int, ...], samples: int, tolerance: float) -> None:
    sides = (0.010, 0.012)[: len(modes)]
    positions = scattered(np.random.default_rng(1), 50, sides)
    assert error(modes, samples, positions, sides, tolerance=tolerance) < tolerance


@pytest.mark.long
@pytest.mark.parametrize("tolerance", [1e-6, 1e-9])
def test_double_precision_meets_tight_tolerances(tolerance: float) -> None:
    sides = (0.010, 0.012)
    positions = scattered(np.random.default_rng(1), 40, sides)
    assert error((16, 15), 64, positions, sides, tolerance=tolerance) < tolerance
    assert error((16, 15), 64, positions[:1], sides, tolerance=tolerance) < tolerance


@pytest.mark.parametrize("steepness", [0.1, 5.0], ids=["short-record", "long-record"])
def test_flat_and_steep_kappa_keep_the_tolerance(steepness: float) -> None:
    positions = scattered(np.random.default_rng(2), 30, (0.01, 0.01))
    assert error((16, 18), 64, positions, (0.01, 0.01), steepness) < 1e-4


@pytest.mark.long
@pytest.mark.parametrize("shape", ["kaiser-bessel", "semicircle"])
def test_every_window_shape_meets_tolerance(shape: str) -> None:
    positions = scattered(np.random.default_rng(3), 30, (0.01, 0.01))
    assert error((16, 18), 64, positions, (0.01, 0.01), window=shape, tolerance=1e-4) < 1e-4


def test_the_papers_window_reaches_double_precision() -> None:
    positions = scattered(np.random.default_rng(3), 30, (0.01, 0.01))
    window = kaiser_bessel(6, 2.0)
    assert (window.width, window.oversampling) == (12, 2.0)
    assert error((16, 18), 64, positions, (0.01, 0.01), window=window, tolerance=1e-10, dtype="float64") < 1e-10


@pytest.mark.parametrize("sensors", [(16, 18), (8, 9), (8, 18), (16, 6)], ids=str)
@pytest.mark.parametrize("shift", [0.0, 0.5], ids=["on-the-modes", "half-a-cell-off"])
def test_gridded_sensors_keep_the_tolerance_also_below_the_modes(sensors: tuple[int, int], shift: float) -> None:
    sides = (0.010, 0.012)
    positions = grid(sensors, sides, shift if shift == 0 or sensors[0] % 2 == 0 else 0.25)
    assert error((16, 18), 64, positions, sides) < 1e-4


def test_a_subset_of_a_grid_is_zero_filled() -> None:
    sides = (0.010, 0.012)
    positions = np.random.default_rng(4).permutation(grid((16, 18), sides))[:60]
    assert error((16, 18), 64, positions, sides) < 1e-4


def test_single_sensor_transform_meets_tolerance() -> None:
    for at in ((0.0, 0.0), (0.0012345, -0.0034), (0.005, 0.006)):
        assert error((16, 18), 64, np.array([at]), (0.010, 0.012)) < 1e-4


def test_sensors_beyond_the_period_are_wrapped_when_allowed() -> None:
    sides = (0.010, 0.012)
    positions = scattered(np.random.default_rng(5), 30, sides) * 1.7
    assert error((16, 18), 64, positions, sides, wrap=True) < 1e-4


def test_time_zero_moves_the_origin_of_time_by_fractions_of_a_sample() -> None:
    positions = scattered(np.random.default_rng(6), 30, (0.01, 0.01))
    assert error((16, 18), 64, positions, (0.01, 0.01), late=0.4125) < 1e-4
    assert error((16, 18), 64, positions, (0.01, 0.01), late=25.7875) < 1e-4
