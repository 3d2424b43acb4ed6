"""Standard errors of direct images: their definition, and what share of the truths intervals hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

import steradian
from steradian import phantoms
from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.imaging import Acquisition, Compute, ImageGrid, Iterative, Nufft, ReconstructionPlan, reconstruct
from steradian.imaging._uncertainty import sensor_order, uncertainty
from steradian.masks import equi_steradian_mask

SIDE, DEPTH, SPEED, INTERVAL, SAMPLES, MODES = 5.04e-3, 1.4e-3, 1500.0, 10e-9, 420, 84
CPU = Compute(device="cpu")
TIMING: dict[str, Any] = {"dt": 40e-9, "sound_speed": SPEED}


def small(seed: int = 0, dimensions: int = 2) -> Acquisition:
    """Return A-lines of noise from 17 sensors, one more than pairs can hold."""
    random = np.random.default_rng(seed)
    where = random.uniform(-1e-3, 1e-3, (17, 2) if dimensions == 2 else 17)
    return Acquisition(random.standard_normal((17, 40)), where, aperture=2e-3, **TIMING)


@pytest.mark.parametrize("dimensions", [1, 2])
def test_the_variance_is_that_of_the_differences_between_neighbours(dimensions: int) -> None:
    """Sum of (b_i − b_j)² over pairs of neighbours, b_i the image of one A-line; the odd sensor is alone."""
    acquisition, grid = small(dimensions=dimensions), ImageGrid(8)
    found = uncertainty(acquisition, grid, replicates=300, compute=CPU)
    plan = ReconstructionPlan(acquisition.geometry, grid, compute=CPU)
    traces = np.asarray(acquisition.traces)
    images = [
        plan.run(traces * (np.arange(17) == number)[:, None]).values for number in sensor_order(acquisition.sensors)
    ]
    variance = sum((images[i] - images[i + 1]) ** 2 for i in range(0, 16, 2)) + images[16] ** 2
    expected = np.sqrt(uniform_filter(variance, 3, mode="nearest"))
    assert found.values.shape == expected.shape
    np.testing.assert_allclose(found.values / expected, 1, atol=0.25)
    assert np.mean(found.values / expected) == pytest.approx(1, abs=0.03)


def test_neighbours_on_a_line_are_next_in_place() -> None:
    where = np.random.default_rng(0).permutation(np.linspace(-1, 1, 20))
    for positions in (where, where[:, None]):
        np.testing.assert_array_equal(where[sensor_order(positions)], np.sort(where))


def test_integer_a_lines_with_a_scale_are_those_of_their_pressures() -> None:
    """The least integer has no opposite of its type: signs are applied in floating point."""
    acquisition = small()
    counts = np.clip(np.asarray(acquisition.traces) * 1e4, -32768, 32767).astype(np.int16)
    counts[3, 7] = -32768
    common: dict[str, Any] = {"aperture": 2e-3, **TIMING}
    whole = Acquisition(counts, acquisition.sensors, scale=1e-4, **common)
    real = Acquisition(counts * 1e-4, acquisition.sensors, **common)
    found, expected = (uncertainty(each, ImageGrid(8), compute=CPU).values for each in (whole, real))
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_result_has_voxels_and_notes_of_the_image_and_reports_progress() -> None:
    told: list[tuple[str, int, int]] = []
    acquisition, grid = small(), ImageGrid(8, depth=(0.3e-3, 1.2e-3))
    found = steradian.uncertainty(acquisition, grid, replicates=3, progress=lambda *said: told.append(said))
    image = reconstruct(acquisition, grid)
    np.testing.assert_array_equal(found.axes.z, image.axes.z)
    assert found.values.min() >= 0
    assert "3 images" in found.info.notes[-1]
    assert told == [("replicates", number, 3) for number in range(4)]
    with pytest.raises(Cancelled):
        uncertainty(acquisition, grid, cancelled=lambda: True)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"replicates": 1}, "replicates"),
        ({"replicates": 2.5}, "replicates"),
        ({"method": Iterative()}, "method"),
        ({"compute": Compute(device="cpu", memory_limit=1000)}, "memory_limit"),
    ],
)
def test_bad_parameters_are_named(change: dict[str, Any], field: str) -> None:
    with pytest.raises(InvalidInput) as error:
        uncertainty(small(), ImageGrid(8), **change)
    assert error.value.field == field


def test_few_sensors_are_refused() -> None:
    with pytest.raises(InvalidInput, match="16 or more"):
        uncertainty(
            Acquisition(np.ones((15, 40)), np.random.default_rng(0).uniform(-1e-3, 1e-3, (15, 2)), **TIMING),
            ImageGrid(8),
        )


def dense_positions() -> np.ndarray:
    line = (np.arange(MODES) - (MODES - 1) / 2) * (SIDE / MODES)
    return np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize(
    "arrangement",
    [pytest.param("random", marks=pytest.mark.nightly), pytest.param("equi-steradian", marks=pytest.mark.long)],
)
def test_intervals_of_one_standard_error_hold_about_68_percent_of_the_truths(arrangement: str) -> None:
    """In 20 simulated scans of 222 points at 20 and 30 dB: of all voxels, and of those of the object.

    The truths are noise-free images from a sensor a voxel, 7,056, of the same area.
    """
    dense, grid = dense_positions(), ImageGrid(MODES, depth=(0.4e-3, 2.4e-3))
    timing: dict[str, Any] = {"dt": INTERVAL, "sound_speed": SPEED, "aperture": SIDE}

    def pressure(balls: phantoms.Balls, where: np.ndarray) -> np.ndarray:
        return phantoms.pressure(balls, where, samples=SAMPLES, sampling_interval=INTERVAL, sound_speed=SPEED)

    shares = []
    for seed in range(5):
        balls = phantoms.yarn(seed, centre=(0.0, 0.0, DEPTH), radius=0.9e-3)
        uniform = np.full(len(dense), SIDE**2 / len(dense))
        truth = reconstruct(
            Acquisition(pressure(balls, dense), dense, weights=uniform, **timing), grid, compute=CPU
        ).values
        for number in range(4):
            random = np.random.default_rng(10 * seed + number)
            where, weights = dense[random.choice(len(dense), 222, replace=False)], "voronoi"
            if arrangement == "equi-steradian":
                mask = equi_steradian_mask(SIDE, DEPTH, 222, weighting="analytic")
                where, weights = mask.positions, mask.weights
            noisy = phantoms.add_noise(pressure(balls, where), (20.0, 30.0)[number % 2], convention="peak", seed=number)
            acquisition = Acquisition(noisy, where, weights=weights, **timing)
            image = reconstruct(acquisition, grid, compute=CPU).values
            error = uncertainty(acquisition, grid, Nufft(), compute=CPU).values
            is_held = np.abs(image - truth) <= error
            shares.append((is_held.mean(), is_held[np.abs(truth) > 0.3 * truth.max()].mean()))
    everywhere, object_ = np.mean(shares, axis=0)
    print(arrangement, everywhere, object_, np.min(shares, axis=0), np.max(shares, axis=0))
    assert 0.60 <= everywhere <= 0.76
    assert 0.60 <= object_ <= 0.76


def test_sensors_may_be_a_mask() -> None:
    mask, grid = equi_steradian_mask(6e-3, 2e-3, 60), ImageGrid(16)
    traces = np.random.default_rng(0).standard_normal((mask.count, 40))
    plain = Acquisition(traces, mask.positions, weights=mask.weights, aperture=mask.aperture, **TIMING)
    expected = uncertainty(plain, grid, compute=CPU).values
    np.testing.assert_array_equal(uncertainty(Acquisition(traces, mask, **TIMING), grid, compute=CPU).values, expected)
