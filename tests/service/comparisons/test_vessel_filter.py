"""Vessel filter against the closed form of a uniform cylinder, a plane sheet and scikit-image's own filter."""

import math
import sys

import numpy as np
import pytest

from steradian import InvalidInput, Volume
from steradian.imaging import VoxelAxes
from steradian.quality import vesselness

STEP = (50e-6, 40e-6, 20e-6)
DIAMETER, PLACE = 300e-6, (0.25e-3, 2e-3)


@pytest.fixture
def filters():
    reason = "needs scikit-image: pip install '.[vessels]'"
    assert pytest.importorskip("skimage.feature", reason=reason).hessian_matrix  # loads its module
    return pytest.importorskip("skimage.filters", reason=reason)


def volume(values, step=STEP):
    x, y = (size * (np.arange(count) - count // 2) for count, size in zip(values.shape[:2], step[:2], strict=True))
    return Volume(values, VoxelAxes(x, y, 1e-3 + step[2] * np.arange(values.shape[2])), step, 1500.0)


@pytest.fixture
def cylinder():
    """Uniform cylinder of value 1 along y; a voxel on its surface has the share inside."""
    empty = volume(np.zeros((40, 8, 100), np.float32))
    part = (np.arange(8) - 3.5) / 8
    x = empty.axes.x[:, None, None, None] + STEP[0] * part[:, None] - PLACE[0]
    z = empty.axes.z[:, None, None] + STEP[2] * part - PLACE[1]
    across = (x**2 + z**2 < (DIAMETER / 2) ** 2).mean(axis=(2, 3))
    return volume(np.repeat(across[:, None], 8, axis=1).astype(np.float32))


def test_response_is_highest_on_the_axis_and_at_the_diameter_of_the_cylinder(filters, cylinder):
    """On the axis it is e q exp(−q) of the cylinder's value; q is the square of its diameter over the filter's."""
    for diameter in (200e-6, 450e-6):
        q = (DIAMETER / diameter) ** 2
        axis = vesselness(cylinder, [diameter]).values[25, 4, 50]
        assert axis == pytest.approx(math.e * q * math.exp(-q), abs=0.03)
    found = vesselness(cylinder, [200e-6, DIAMETER])
    x, z = np.unravel_index(found.values[:, 4].argmax(), (40, 100))
    assert abs(found.axes.x[x] - PLACE[0]) < 1e-9
    assert abs(found.axes.z[z] - PLACE[1]) < 1e-9
    assert found.values[x, 4, z] == pytest.approx(1, abs=0.02)
    assert found.values[np.abs(found.axes.x - PLACE[0]) > 0.6e-3].max() < 0.03
    assert (found.values.dtype, found.spacing, found.sound_speed) == (np.float32, STEP, 1500.0)


def test_plane_sheet_and_dark_tube_have_no_response(filters, cylinder):
    sheet = np.zeros((24, 8, 60), np.float32)
    sheet[..., 25:35] = 1
    assert vesselness(volume(sheet), [200e-6]).values.max() < 1e-3
    assert vesselness(volume(1 - cylinder.values), [DIAMETER]).values[25, 4, 50] == 0


def test_slabs_together_are_the_filter_of_scikit_image(filters, monkeypatch):
    monkeypatch.setattr("steradian.quality.vessel_filter.SLAB_VOXELS", 3 * 21 * 22)
    values = np.random.default_rng(0).random((20, 21, 22)).astype(np.float32)
    diameters = [3e-4, 5e-4]
    sigmas = [diameter / math.sqrt(8) / 1e-4 for diameter in diameters]
    expected = math.e * filters.sato(values, sigmas, black_ridges=False, mode="nearest")
    np.testing.assert_allclose(vesselness(volume(values, 3 * (1e-4,)), diameters).values, expected, atol=1e-4)


def test_wrong_diameters_and_volumes_are_refused(filters, cylinder):
    for diameters in ([], [99e-6], [math.nan], [math.inf]):
        with pytest.raises(InvalidInput, match="diameters"):
            vesselness(cylinder, diameters)
    for values in (np.full((4, 4, 4), np.nan), np.ones((4, 4))):
        with pytest.raises(InvalidInput, match="volume"):
            vesselness(Volume(values, cylinder.axes, STEP[: values.ndim]), [DIAMETER])


def test_without_scikit_image_the_error_names_the_extra(cylinder, monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage.feature", None)
    with pytest.raises(ImportError, match=r"steradian\[vessels\]"):
        vesselness(cylinder, [DIAMETER])
