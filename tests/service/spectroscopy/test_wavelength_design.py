"""Choice of wavelengths: expected errors against repeated unmixing, the best set against all sets."""

from itertools import combinations

import numpy as np
import pytest

from steradian import InvalidInput
from steradian.spectroscopy import TissueFluence, best_wavelengths, chromophore, wavelength_set

BLOOD = 150 / 64_500


def test_expected_error_is_the_scatter_of_unmixed_saturations():
    light = np.array([730e-9, 760e-9, 800e-9, 850e-9])
    depth, noise, tissue = 3e-3, 0.004, TissueFluence()
    matrix = np.column_stack([chromophore(name).at(light) for name in ("HbO2", "Hb")])
    fluence = np.exp(-tissue.attenuation(light) * depth)
    near = np.arange(700e-9, 901e-9, 10e-9)
    surface = max(0.75 * chromophore("HbO2").at(near) + 0.25 * chromophore("Hb").at(near))
    random, errors = np.random.default_rng(0), []
    for saturation in (0.5, 0.6, 0.7, 0.8, 0.9, 1.0):
        image = fluence * (matrix @ [saturation, 1 - saturation])
        repeated = image + noise * surface * random.standard_normal((20_000, 4))
        found = np.linalg.lstsq(fluence[:, None] * matrix, repeated.T, rcond=None)[0]
        errors.append(np.std(found[0] / found.sum(axis=0)))
    expected = wavelength_set(light, depth=depth, noise=noise, tissue=tissue)
    assert expected.saturation_error == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=0.03)
    scaled = fluence[:, None] * matrix
    assert expected.condition == pytest.approx(np.linalg.cond(scaled / np.linalg.norm(scaled, axis=0)))


@pytest.mark.parametrize("chromophores", [("HbO2", "Hb"), ("HbO2", "Hb", "water")])
def test_best_set_is_that_of_all_sets(chromophores):
    candidates = 1e-9 * np.arange(700, 910, 20)
    found = best_wavelengths(candidates, 4, chromophores)
    least = min(wavelength_set(each, chromophores).saturation_error for each in combinations(candidates, 4))
    assert found.saturation_error == pytest.approx(least, rel=1e-6)
    assert len(found.wavelengths) == 4


def test_deep_blood_and_noise_raise_the_expected_error():
    light = (730e-9, 760e-9, 850e-9)
    near, deep = (wavelength_set(light, depth=depth) for depth in (1e-3, 4e-3))
    assert deep.saturation_error > 1.3 * near.saturation_error
    assert wavelength_set(light, depth=1e-3, noise=0.06).saturation_error == pytest.approx(2 * near.saturation_error)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"wavelengths": [7e-7]}, "wavelengths is 1; allowed: at least 2"),
        ({"wavelengths": [7e-7, 7.001e-7]}, "each once"),
        ({"wavelengths": [7e-7, 8e-7], "depth": -1e-3}, "depth.*0 to 0.1 m"),
        ({"wavelengths": [7e-7, 8e-7], "noise": 0}, "noise.*above 0"),
        ({"wavelengths": [7e-7, 8e-7], "chromophores": ["water", "HbO2"]}, "oxyhaemoglobin, deoxyhaemoglobin first"),
        ({"wavelengths": [7e-7, 2e-6]}, "wavelength is 2000 nm"),
    ],
)
def test_wrong_values_are_refused_with_field_and_range(arguments, told):
    with pytest.raises(InvalidInput, match=told):
        wavelength_set(**arguments)


def test_more_wavelengths_than_candidates_are_refused():
    with pytest.raises(InvalidInput, match="count is 5; allowed: a whole number from 2 to 3"):
        best_wavelengths([7e-7, 7.5e-7, 8e-7], 5)
