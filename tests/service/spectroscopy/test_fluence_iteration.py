"""Fixed point of absorption and fluence by depth, on images by formula; fluence in layers; own maps."""

import numpy as np
import pytest

from steradian import InvalidInput
from steradian.imaging.volume import VoxelAxes
from steradian.spectroscopy import (
    FluenceMap,
    LayeredTissueFluence,
    TissueFluence,
    chromophore,
    iterate_tissue_fluence,
)

LIGHT = (750e-9, 850e-9)
AXES = VoxelAxes(np.linspace(-1e-3, 1e-3, 20), np.linspace(-1e-3, 1e-3, 20), np.linspace(0.5e-3, 5e-3, 46))
TISSUE = TissueFluence(blood=0.08, saturation=0.6)
SPECTRA = np.column_stack([chromophore(name).at(LIGHT) for name in ("HbO2", "Hb")])


def images(saturation, fluence, noise=1e-4):
    """Vessels with a saturation (z,) in a fifth of each slice, in white noise of a share of the maximum."""
    blood = np.stack([saturation, 1 - saturation])
    lines = SPECTRA @ blood * fluence.relative(np.array(LIGHT), AXES)[:, 0, 0]
    made = np.zeros((2, 20, 20, 46))
    made[:, 8:12] = lines[:, None, None]
    return made + noise * made.max() * np.random.default_rng(0).standard_normal(made.shape)


def error_of(values, saturation, fluence):
    """Mean error of saturation of the vessels, unmixed by NumPy."""
    relative = np.broadcast_to(fluence.relative(np.array(LIGHT), AXES), (2, 1, 1, 46))
    pair = np.linalg.solve(SPECTRA, (values / relative)[:, 9, 9])
    return np.abs(pair[0] / pair.sum(axis=0) - saturation).mean()


def test_layers_of_one_kind_are_homogeneous_tissue():
    layers = LayeredTissueFluence(TISSUE, AXES.z, np.full(46, 0.08), np.full(46, 0.6))
    np.testing.assert_allclose(
        layers.relative(np.array(LIGHT), AXES), TISSUE.relative(np.array(LIGHT), AXES), rtol=1e-9
    )


def test_light_through_two_layers_is_the_product_of_both():
    depths = np.array([1e-3, 2e-3, 2e-3 + 1e-9, 4e-3])
    layers = LayeredTissueFluence(TISSUE, depths, np.array([0.02, 0.02, 0.1, 0.1]), np.array([0.9, 0.9, 0.5, 0.5]))
    axes = VoxelAxes(AXES.x, AXES.y, np.array([0.5e-3, 1.5e-3, 3e-3, 5e-3]))
    first, second = (
        TissueFluence(blood, saturation).attenuation(LIGHT)[:, None] for blood, saturation in ((0.02, 0.9), (0.1, 0.5))
    )
    expected = np.exp(-first * np.minimum(axes.z, 2e-3) - second * np.maximum(axes.z - 2e-3, 0))
    np.testing.assert_allclose(layers.relative(np.array(LIGHT), axes)[:, 0, 0], expected, rtol=1e-5)


def test_iteration_finds_tissue_of_the_vessels_saturation_with_two_wavelengths():
    saturation = np.full(46, 0.6)
    values = images(saturation, TISSUE)
    start = TissueFluence(blood=0.08, saturation=0.9)
    found = iterate_tissue_fluence(values, LIGHT, AXES, start=start)
    assert found.converged
    assert len(found.changes) < 10
    assert error_of(values, saturation, start) > 0.05
    assert error_of(values, saturation, found.fluence) < 0.01
    np.testing.assert_allclose(found.fluence.saturation, 0.6, atol=0.02)


def test_iteration_misleads_where_the_tissue_has_another_saturation_than_the_vessels():
    saturation = np.full(46, 0.95)
    values = images(saturation, TISSUE)
    found = iterate_tissue_fluence(values, LIGHT, AXES, start=TISSUE)
    assert error_of(values, saturation, TISSUE) < 0.01
    assert error_of(values, saturation, found.fluence) > 0.03


def test_iteration_refuses_with_field_and_range():
    values = images(np.full(46, 0.6), TISSUE)
    for options, told in (
        ({"change": 0.0}, r"change is 0\.0; allowed: above 0, at most 0\.1"),
        ({"rounds": 0}, "rounds is 0; allowed: a whole number from 1 to 1000"),
        ({"chromophores": ["water"]}, "chromophores is water"),
        ({"chromophores": ["oxyhaemoglobin", "deoxyhaemoglobin", "water"]}, "wavelengths is 2; allowed: at least 3"),
    ):
        with pytest.raises(InvalidInput, match=told):
            iterate_tissue_fluence(values, LIGHT, AXES, **options)
    with pytest.raises(InvalidInput, match="no voxel"):
        iterate_tissue_fluence(np.ones((2, 20, 20, 46)), LIGHT, AXES)


def test_map_on_a_coarse_grid_is_exact_for_exponential_decay():
    coarse = VoxelAxes(np.array([-2e-3, 2e-3]), np.array([-2e-3, 2e-3]), np.linspace(0, 6e-3, 4))
    own = np.broadcast_to(TISSUE.relative(np.array(LIGHT), coarse), (2, 2, 2, 4))
    found = FluenceMap(own[::-1], LIGHT[::-1], coarse).relative(np.array(LIGHT), AXES)
    assert found.shape == (2, 20, 20, 46)
    np.testing.assert_allclose(found[:, 3, 4], TISSUE.relative(np.array(LIGHT), AXES)[:, 0, 0], rtol=1e-9)


def test_map_refuses_missing_wavelength_and_extent():
    own = np.ones((2, 2, 2, 4))
    small = VoxelAxes(AXES.x[[0, -1]], AXES.y[[0, -1]], np.linspace(0, 3e-3, 4))
    with pytest.raises(InvalidInput, match="no map for 850 nm; allowed: wavelengths of the map: 750, 800 nm"):
        FluenceMap(own, (750e-9, 800e-9)).relative(np.array(LIGHT), AXES)
    with pytest.raises(InvalidInput, match=r"z from 0 to 3 mm; allowed: at least 0\.5 to 5 mm"):
        FluenceMap(own, LIGHT, small).relative(np.array(LIGHT), AXES)
