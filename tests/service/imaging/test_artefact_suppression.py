"""Artefact suppression by half-set images: objects stay, streaks of few sensors and noise go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import steradian
from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.imaging import Acquisition, ImageGrid, Iterative
from steradian.imaging.artefact_suppression import wiener_weights
from steradian.phantoms import pressure, rasterise, yarn

MASK = steradian.equi_steradian_mask(6e-3, 2e-3, 300)
GRID = ImageGrid(modes=64, depth=(0.8e-3, 3.2e-3))
BALLS = yarn(2, centre=(0.0, 0.0, 2e-3), radius=0.9e-3)


@pytest.fixture(scope="module")
def acquisition() -> Acquisition:
    traces = pressure(BALLS, MASK.positions, samples=160, sampling_interval=2e-8, sound_speed=1500.0)
    noise = np.random.default_rng(0).standard_normal(traces.shape) * 0.03 * np.abs(traces).max()
    return Acquisition(traces + noise, MASK, dt=2e-8, sound_speed=1500.0)


def test_sparse_image_is_nearer_to_the_object(acquisition: Acquisition) -> None:
    direct = steradian.reconstruct(acquisition, GRID)
    found = steradian.suppress_artefacts(acquisition, GRID)
    truth = np.asarray(rasterise(BALLS, direct).values)
    before, after = (np.corrcoef(truth.ravel(), np.asarray(v.values).ravel())[0, 1] for v in (direct, found))
    assert after > before + 0.15
    inside = truth > 0.5 * truth.max()
    amplitudes = np.asarray(found.values)[inside].mean() / np.asarray(direct.values)[inside].mean()
    assert 0.85 < amplitudes <= 1
    assert "half-set Wiener filter" in found.info.notes[-1]
    assert not direct.info.notes  # never unasked


def test_noise_alone_is_suppressed(acquisition: Acquisition) -> None:
    noise = np.random.default_rng(1).standard_normal(np.shape(acquisition.traces))
    found = steradian.suppress_artefacts(replace(acquisition, traces=noise), GRID)
    direct = steradian.reconstruct(replace(acquisition, traces=noise), GRID)
    assert np.linalg.norm(found.values) < 0.35 * np.linalg.norm(direct.values)


def test_weights_of_equal_halves_are_one_and_of_opposite_ones_nought(acquisition: Acquisition) -> None:
    volume = steradian.reconstruct(acquisition, GRID)
    np.testing.assert_allclose(wiener_weights(volume, volume, 1e-4), 1, atol=1e-4)
    opposite = replace(volume, values=-1.01 * np.asarray(volume.values))
    assert wiener_weights(volume, opposite, 1e-4).max() == 0


@pytest.mark.parametrize("scale", [1e-24, 1e18])
def test_unit_of_the_a_lines_plays_no_part(acquisition: Acquisition, scale: float) -> None:
    expected = np.asarray(steradian.suppress_artefacts(acquisition, GRID).values)
    scaled = replace(acquisition, traces=scale * np.asarray(acquisition.traces))
    found = np.asarray(steradian.suppress_artefacts(scaled, GRID).values) / scale
    assert np.linalg.norm(found - expected) < 1e-3 * np.linalg.norm(expected)


def test_sensitivities_go_with_their_sensors(acquisition: Acquisition) -> None:
    factors = np.where(np.arange(MASK.count) % 3 == 0, 0.5, 1.0)
    less = replace(acquisition, traces=np.asarray(acquisition.traces) * factors[:, None], sensitivity=factors)
    truth = np.asarray(rasterise(BALLS, steradian.reconstruct(acquisition, GRID)).values).ravel()
    found, plain = (
        np.corrcoef(truth, np.asarray(steradian.suppress_artefacts(each, GRID).values).ravel())[0, 1]
        for each in (less, acquisition)
    )
    assert found > plain - 0.1


def test_wrong_input_is_refused_and_work_is_cancelled(acquisition: Acquisition) -> None:
    with pytest.raises(InvalidInput, match="smoothing"):
        steradian.suppress_artefacts(acquisition, GRID, smoothing=-1.0)
    with pytest.raises(InvalidInput, match="method"):
        steradian.suppress_artefacts(acquisition, GRID, Iterative())  # type: ignore[arg-type]
    few = Acquisition(
        np.asarray(acquisition.traces)[:9], MASK.positions[:9], dt=2e-8, sound_speed=1500.0, aperture=6e-3
    )
    with pytest.raises(InvalidInput, match="sensors"):
        steradian.suppress_artefacts(few, GRID)
    line = Acquisition(
        np.asarray(acquisition.traces), np.linspace(-2e-3, 2e-3, MASK.count), dt=2e-8, sound_speed=1500.0, aperture=6e-3
    )
    with pytest.raises(InvalidInput, match="sensors"):
        steradian.suppress_artefacts(line, GRID)
    with pytest.raises(InvalidInput, match="traces"):
        steradian.suppress_artefacts(replace(acquisition, traces=np.asarray(acquisition.traces)[:-1]), GRID)
    with pytest.raises(InvalidInput, match="sensitivity"):
        steradian.suppress_artefacts(replace(acquisition, sensitivity=np.ones(5)), GRID)
    with pytest.raises(Cancelled):
        steradian.suppress_artefacts(acquisition, GRID, cancelled=lambda: True)
