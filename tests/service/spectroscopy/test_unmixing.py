"""Unmixing of series made by formula: concentrations, saturation, their intervals, fluence and empty voxels."""

import numpy as np
import pytest
from scipy.optimize import nnls

from steradian import InvalidInput, Volume
from steradian.imaging.volume import VoxelAxes
from steradian.spectroscopy import (
    ExponentialFluence,
    FluenceMap,
    TissueFluence,
    UniformFluence,
    chromophore,
    fit_tissue_fluence,
    unmix,
)
from steradian.spectroscopy.linear_inversion import background_covariance, solve_spectra

LIGHT = 1e-9 * np.array([700.0, 730.0, 760.0, 800.0, 850.0])
NAMES = ("oxyhaemoglobin", "deoxyhaemoglobin")
SHAPE = (40, 40, 24)
AXES = VoxelAxes(np.linspace(-2e-3, 2e-3, 40), np.linspace(-2e-3, 2e-3, 40), np.linspace(1e-3, 5e-3, 24))
ABSORPTION = np.column_stack([chromophore(name).at(LIGHT) for name in NAMES])
OBJECT = np.zeros(SHAPE, bool)
OBJECT[12:18, 5:35] = True
RANDOM = np.random.default_rng(0)
SATURATION = RANDOM.uniform(0.6, 0.98, SHAPE)


def series(fluence, noise, seed=0):
    """Images of blood with a random saturation in each voxel, in white noise of a share of the greatest value."""
    pair = np.stack([SATURATION, 1 - SATURATION])
    images = np.einsum("ki,ixyz->kxyz", ABSORPTION, pair) * OBJECT * fluence.relative(LIGHT, AXES)
    noisy = images + noise * images.max() * np.random.default_rng(seed).standard_normal(images.shape)
    return [Volume(each.astype(np.float32), AXES, (1e-4, 1e-4, 1.7e-4), 1500.0) for each in noisy]


def test_known_fluence_gives_saturation_and_intervals_that_hold_68_per_cent_of_truths():
    fluence = ExponentialFluence((400.0, 380.0, 360.0, 300.0, 280.0), (1.0, 0.9, 1.1, 1.0, 0.8))
    found = unmix(series(fluence, 0.003), LIGHT, fluence=fluence)
    inside = OBJECT & found.has_signal
    assert inside.sum() > 0.95 * OBJECT.sum()
    errors = (found.saturation - SATURATION)[inside]
    assert abs(errors.mean()) < 0.01
    assert 0.63 < np.mean(abs(errors) <= found.saturation_error[inside]) < 0.73
    assert not found.notes
    assert found.misfit == pytest.approx(1.0, abs=0.1)


def test_concentrations_and_total_haemoglobin_have_their_ratio_to_the_truth():
    found = unmix(series(UniformFluence(), 0.003), LIGHT, fluence=UniformFluence())
    np.testing.assert_allclose(found.haemoglobin[OBJECT], 1.0, atol=5 * found.haemoglobin_error[OBJECT].max())
    errors = (found.concentrations[1] - (1 - SATURATION))[OBJECT]
    assert 0.63 < np.mean(abs(errors) <= found.standard_errors[1][OBJECT]) < 0.73


def test_voxels_without_signal_are_empty():
    found = unmix(series(UniformFluence(), 0.01), LIGHT, fluence=UniformFluence())
    assert np.isnan(found.concentrations[:, ~OBJECT]).mean() > 0.999
    assert np.isnan(found.saturation[~OBJECT]).mean() > 0.999
    assert np.isfinite(found.saturation[OBJECT]).mean() > 0.999


def test_without_fluence_a_note_warns_and_saturation_is_biased_with_depth():
    tissue = TissueFluence(blood=0.1, saturation=0.4)
    volumes = series(tissue, 1e-4)
    plain, known = unmix(volumes, LIGHT), unmix(volumes, LIGHT, fluence=tissue)
    assert "oxygen saturation is biased" in plain.notes[0]
    deep = OBJECT.copy()
    deep[..., : 2 * SHAPE[2] // 3] = False
    assert abs(np.nanmean((plain.saturation - SATURATION)[deep])) > 0.15
    assert abs(np.nanmean((known.saturation - SATURATION)[deep])) < 0.01


def test_fitted_tissue_fluence_finds_blood_and_saturation_of_the_tissue():
    tissue = TissueFluence(blood=0.06, saturation=0.55)
    volumes = series(tissue, 3e-4)
    fitted = fit_tissue_fluence(np.stack([each.values for each in volumes]), LIGHT, AXES)
    assert fitted.fluence.blood == pytest.approx(0.06, rel=0.1)
    assert fitted.fluence.saturation == pytest.approx(0.55, abs=0.03)
    assert fitted.misfit < 0.7 * fitted.misfit_before
    found = unmix(volumes, LIGHT, fluence=fitted.fluence)
    assert abs(np.nanmean((found.saturation - SATURATION)[OBJECT])) < 0.02


def test_map_of_the_fluence_is_taken_voxel_by_voxel():
    values = 0.5 + RANDOM.random((5, *SHAPE))
    fluence = FluenceMap(values)
    found = unmix(series(fluence, 1e-3), LIGHT, fluence=fluence)
    assert np.nanstd((found.saturation - SATURATION)[OBJECT]) < 0.05


def test_non_negative_solutions_are_those_of_nnls():
    matrix = RANDOM.random((6, 3))
    spectra = RANDOM.standard_normal((6, 200))
    found, *_ = solve_spectra(spectra, matrix, np.eye(6), non_negative=True)
    np.testing.assert_allclose(found, np.array([nnls(matrix, each)[0] for each in spectra.T]).T, atol=1e-12)


def test_background_covariance_is_that_of_correlated_noise_beside_an_object():
    true = 0.04 * np.array([[1.0, 0.6, 0.1], [0.6, 2.0, -0.4], [0.1, -0.4, 0.5]])
    noise = np.einsum("kl,lxyz->kxyz", np.linalg.cholesky(true), RANDOM.standard_normal((3, 80, 80, 8)))
    noise[:, 20:30, 20:30] += 50.0
    found = background_covariance(noise)
    np.testing.assert_allclose(found, np.broadcast_to(true, (8, 3, 3)), atol=0.012)


def test_result_is_shown_as_a_volume_by_name():
    found = unmix(series(UniformFluence(), 0.003), LIGHT, fluence=UniformFluence())
    shown = found.as_volume("saturation")
    assert shown.spacing == (1e-4, 1e-4, 1.7e-4)
    np.testing.assert_array_equal(shown.values, found.saturation)
    with pytest.raises(InvalidInput, match="name is lipid; allowed: oxyhaemoglobin, deoxyhaemoglobin, saturation"):
        found.as_volume("lipid")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"wavelengths": LIGHT[:4]}, "wavelengths is 4; allowed: one for each of 5 volumes"),
        ({"wavelengths": [7e-7, 7e-7, 7.6e-7, 8e-7, 8.5e-7]}, "each once"),
        ({"chromophores": ["HbO2", "oxyhaemoglobin"]}, "1 to 6, each once"),
        ({"chromophores": []}, "chromophores is none"),
        ({"fluence": ExponentialFluence((1.0, 2.0))}, "attenuation.*5 numbers from 0"),
        ({"fluence": FluenceMap(np.ones((5, 3, 1, 1)))}, r"fluence is an array of shape \(5, 3, 1, 1\)"),
        ({"fluence": FluenceMap(np.zeros((5, 1, 1, 1)))}, "above 0 everywhere"),
    ],
)
def test_wrong_values_are_refused_with_field_and_range(change, told):
    with pytest.raises(InvalidInput, match=told):
        unmix(series(UniformFluence(), 0.01), **{"wavelengths": LIGHT} | change)


def test_two_wavelengths_for_three_chromophores_are_refused():
    with pytest.raises(InvalidInput, match="at least 3, as many as chromophores"):
        unmix(series(UniformFluence(), 0.01)[:2], LIGHT[:2], ("HbO2", "Hb", "water"))


@pytest.mark.parametrize(("field", "value"), [("blood", 1.2), ("saturation", -0.1), ("scattering", 0.5)])
def test_impossible_tissue_is_refused(field, value):
    with pytest.raises(InvalidInput, match=f"{field} is {value:g}; allowed: from"):
        TissueFluence(**{field: value})
