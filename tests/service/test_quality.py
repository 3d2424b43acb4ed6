"""Quality figures against closed forms."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from steradian import InvalidInput, quality
from steradian.imaging import Volume, VoxelAxes


def volume(values: np.ndarray, step: float = 1e-4) -> Volume:
    coordinates = [step * (np.arange(n) - n // 2) for n in values.shape]
    y = coordinates[1] if values.ndim == 3 else None
    return Volume(values, VoxelAxes(coordinates[0], y, coordinates[-1]), (step,) * values.ndim)


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(5)


def test_correlation_is_numpys_also_over_many_blocks(random, monkeypatch) -> None:
    monkeypatch.setattr("steradian.quality.pearson._BLOCK", 100)
    a = random.standard_normal((13, 9, 7)).astype(np.float32) + 1e3
    b = (a + random.standard_normal(a.shape)).astype(np.float32)
    region = random.random(a.shape) < 0.3
    assert_allclose(quality.correlation(a, b), np.corrcoef(a.ravel(), b.ravel())[0, 1], rtol=1e-9)
    assert_allclose(quality.correlation(a, b, region), np.corrcoef(a[region], b[region])[0, 1], rtol=1e-9)


def test_correlation_ignores_scale_and_offset_but_not_sign(random) -> None:
    a = random.random((20, 20))
    assert_allclose([quality.correlation(a, 3 * a + 7), quality.correlation(a, -a)], [1, -1])


def test_correlation_refuses_constant_images_other_shapes_and_tiny_regions() -> None:
    a = np.arange(9.0).reshape(3, 3)
    for other, region in ((np.ones((3, 3)), None), (np.ones((3, 2)), None), (a.T, np.eye(3)[0] * np.zeros((3, 3)))):
        with pytest.raises(InvalidInput):
            quality.correlation(a, other, region)


def test_tenenbaum_of_a_slope_is_that_of_sobels_operator_by_hand() -> None:
    """Sobel's operator gives 8 times the slope, (1 + 2 + 1)·2; both directions are squared and added (appendix B)."""
    i, j = np.mgrid[:9, :7]
    assert_allclose(quality.tenenbaum(2.0 * i - 3.0 * j + 5), 64 * (4 + 9))


def test_tenenbaum_of_a_single_pixel_counts_the_nine_taps() -> None:
    """Each of the two operators holds the taps 1, 2, 1 twice, squares 12, over 5 × 5 places with neighbours."""
    image = np.zeros((7, 7))
    image[3, 3] = 1
    assert_allclose(quality.tenenbaum(image), 2 * 12 / 25)


def test_tenenbaum_of_a_volume_weighs_the_planes_beside() -> None:
    i, _, k = np.mgrid[:6, :5, :4]
    assert_allclose(quality.tenenbaum((i + 2 * k).astype(np.float32)), 32**2 * (1 + 4))


def test_tenenbaum_uses_only_bounding_rectangle_of_region() -> None:
    image = np.zeros((20, 20))
    image[:10] = np.arange(20.0)  # a slope of 1 in the upper half, an edge below it
    region = np.zeros_like(image, dtype=bool)
    region[1, 2] = region[7, 11] = True
    assert quality.bounding_slices(region) == (slice(1, 8), slice(2, 12))
    assert_allclose(quality.tenenbaum(image, region), 64)
    with pytest.raises(InvalidInput):
        quality.tenenbaum(image, np.zeros_like(region))


def test_blur_lowers_the_sharpness(random) -> None:
    image = random.random((40, 40))
    blurred = (image + np.roll(image, 1, 0) + np.roll(image, 1, 1)) / 3
    assert quality.tenenbaum(blurred) < 0.6 * quality.tenenbaum(image)


def test_a_lorentzian_line_gets_its_width_within_the_standard_error(random) -> None:
    """Fifty noisy lines of 23 µm: two thirds of the errors lie within about one standard error, the mean is right."""
    z = 11.84e-6 * np.arange(60)
    width, errors, stated = 35e-6, [], []
    for _ in range(50):
        centre = 3e-4 + 12e-6 * random.random()
        line = 2.0 / (1 + 4 * ((z - centre) / width) ** 2)
        fit = quality.line_spread(z, line + 0.02 * random.standard_normal(len(z)))
        errors.append(fit.fwhm - width)
        stated.append(fit.standard_error)
        assert abs(fit.centre - centre) < 2e-6
        assert abs(fit.height - 2) < 0.15
    assert abs(np.mean(errors)) < 3 * np.mean(stated) / np.sqrt(50)
    assert 0.5 < np.std(errors) / np.mean(stated) < 1.6


def test_a_lorentzian_through_eight_points_reads_low_on_a_gaussian_line_and_the_direct_width_does_not() -> None:
    z = 11.84e-6 * np.arange(-20, 21)
    fwhm = 40e-6
    line = np.exp(-4 * np.log(2) * (z / fwhm) ** 2)
    fit = quality.line_spread(z, line)
    assert fit.fwhm < 0.93 * fwhm
    assert abs(fit.direct_fwhm - fwhm) < 0.03 * fwhm


def test_the_line_fit_sees_as_many_points_as_asked_for_around_the_maximum() -> None:
    z = np.arange(40.0)
    line = 1 / (1 + 4 * ((z - 20.3) / 3) ** 2)
    line[28:] += 0.2 * np.sin(z[28:])  # something else, further away
    assert_allclose(quality.line_spread(z, line).fwhm, 3, rtol=1e-6)
    assert abs(quality.line_spread(z, line, points=None).fwhm - 3) > 0.01


@pytest.mark.parametrize("step", [3.0, -3.0])
def test_an_arctan_edge_gets_its_width_rising_and_falling(step, random) -> None:
    x = 30e-6 * np.arange(-8, 9)
    width, fits = 33e-6, []
    for _ in range(40):
        edge = 1.0 + step * (np.arctan((x - 10e-6) / (width / 2)) / np.pi + 0.5)
        fits.append(quality.edge_spread(x, edge + 0.02 * random.standard_normal(len(x))))
    errors = np.array([fit.fwhm - width for fit in fits])
    stated = np.mean([fit.standard_error for fit in fits])
    assert abs(errors.mean()) < 3 * stated / np.sqrt(40)
    assert 0.5 < errors.std() / stated < 1.6
    assert_allclose(np.mean([fit.height for fit in fits]), step, rtol=0.03)


def test_the_direct_width_of_an_edge_is_that_of_its_slope() -> None:
    x = 5e-6 * np.arange(-40, 41)
    fwhm = 60e-6
    slope = np.exp(-4 * np.log(2) * (x / fwhm) ** 2)
    fit = quality.edge_spread(x, np.cumsum(slope))
    assert abs(fit.direct_fwhm - fwhm) < 1e-6


def test_a_line_that_does_not_fall_to_half_has_no_direct_width() -> None:
    assert np.isnan(quality.direct_fwhm(np.arange(5.0), [1, 2, 3, 2, 1.6]))
    assert quality.direct_fwhm(np.arange(5.0), [0, 1, 2, 1, 0]) == 2


def test_spread_fits_of_invalid_profiles_are_refused() -> None:
    with pytest.raises(InvalidInput):
        quality.line_spread([0, 1, 2, 3], [-1, -2, -3, -4])
    with pytest.raises(InvalidInput):
        quality.line_spread([0, 2, 1, 3], [1, 2, 3, 4])
    with pytest.raises(InvalidInput):
        quality.edge_spread(np.arange(8.0), np.ones(8))
    with pytest.raises(InvalidInput):
        quality.line_spread([0, 1, 2], [1, 2, 1])


def test_contrast_and_peak_to_background_by_hand() -> None:
    image = np.array([[4.0, 1.0], [-1.0, 1.0]])
    inside = np.array([[True, False], [False, False]])
    assert_allclose(quality.contrast(image, inside), (4 - 1 / 3) / (4 + 1 / 3))
    assert_allclose(quality.peak_to_background(image, inside), 4 / 1)
    assert_allclose(quality.contrast_to_noise(image, inside), (4 - 1 / 3) / np.std([1, -1, 1]))
    with pytest.raises(InvalidInput):
        quality.contrast(image, np.zeros((2, 2)))


def test_modulation_of_bars_falls_with_their_depth() -> None:
    x = np.linspace(0, 20 * np.pi, 2000)
    assert_allclose(quality.modulation(1 + 0.5 * np.sin(x)), 0.5 * 0.951, atol=0.01)
    assert quality.modulation(np.ones(9)) == 0


def test_an_image_compared_with_itself_is_perfect_at_any_scale(random) -> None:
    truth = volume(random.random((12, 14, 10)).astype(np.float32))
    image = volume(2.5 * truth.values)
    figures = quality.compare(image, truth, diameter=8e-4)
    ones = [value for name, value in figures.items() if "correlation" in name]
    assert len(ones) == 5
    assert_allclose(ones, 1)
    assert_allclose([figures["volume_error"], figures["volume_amplitude"]], [0, 2.5], atol=1e-3)
    assert_allclose(figures["mip_z_sharpness"], figures["mip_z_reference_sharpness"], rtol=1e-5)


def test_volume_correlation_detects_artefacts_hidden_in_projection() -> None:
    """Artefacts below the maximum of their columns leave the z-projection alone; the volume's figure tells them."""
    values = np.zeros((20, 20, 20), np.float32)
    values[6:14, 9:12, 10] = 1
    values[12, 4:16, 12] = 0.8
    spoilt = values.copy()
    spoilt[6:14, 9:12, 2:8] = 0.9
    figures = quality.compare(volume(spoilt), volume(values))
    assert figures["mip_z_correlation"] > 0.999
    assert figures["volume_correlation"] < 0.5


def test_compare_with_diameter_ignores_voxels_outside_disc() -> None:
    values = np.zeros((40, 40, 6), np.float32)
    values[18:23, 17:24, 3] = 1
    values[20, 20, 3] = 2
    spoilt = values.copy()
    spoilt[2:5, 2:5] = 3
    assert quality.compare(volume(spoilt), volume(values))["volume_correlation"] < 0.5
    assert_allclose(quality.compare(volume(spoilt), volume(values), diameter=2e-3)["volume_correlation"], 1)


def test_images_of_lines_are_compared_too(random) -> None:
    truth = volume(random.random((30, 20)))
    figures = quality.compare(truth, truth, diameter=1e-3)
    assert set(figures) == {
        "image_correlation",
        "image_correlation_of_interest",
        "image_sharpness",
        "image_reference_sharpness",
        "image_error",
        "image_amplitude",
    }


def test_images_with_other_voxels_are_refused(random) -> None:
    values = random.random((8, 8, 8))
    with pytest.raises(InvalidInput):
        quality.compare(volume(values), volume(values, 1.1e-4))
    with pytest.raises(InvalidInput):
        quality.compare(volume(values), volume(values[:7]))


def test_the_disc_has_its_area_and_its_centre() -> None:
    axis = np.linspace(-1, 1, 401)
    inside = quality.disc(axis, axis, 1.0, centre=(0.2, -0.3))
    assert abs(inside.mean() * 4 - np.pi / 4) < 0.02
    i, j = np.nonzero(inside)
    assert_allclose([axis[i].mean(), axis[j].mean()], [0.2, -0.3], atol=1e-3)


def test_importing_quality_loads_neither_scipy_nor_a_compiler() -> None:
    code = (
        "import sys, steradian; steradian.quality.tenenbaum; print([m for m in ('scipy', 'numba') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
