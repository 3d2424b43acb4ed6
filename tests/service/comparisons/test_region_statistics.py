"""Regions of interest: voxels by formula, statistics by NumPy on the exported NIfTI, and errors."""

import numpy as np
import pytest

from steradian import InvalidInput, Volume
from steradian.imaging import VoxelAxes
from steradian.quality import AboveThreshold, Box, Ellipsoid, Polygon, region_statistics

STEP = (100e-6, 100e-6, 50e-6)
AXES = VoxelAxes(*(step * (np.arange(30) - 15) for step in STEP[:2]), STEP[2] * np.arange(40))
VALUES = np.random.default_rng(0).normal(1.0, 0.3, (30, 30, 40)).astype(np.float32)
VOLUME = Volume(VALUES, AXES, STEP, 1500.0)
BOX = Box("vessel", ((-0.5e-3, 0.51e-3), (0.0, 0.95e-3), (0.5e-3, 1.0e-3)))


def test_box_has_the_figures_of_numpy_on_the_exported_nifti(tmp_path):
    nibabel = pytest.importorskip("nibabel", reason="pip install '.[export]'")
    VOLUME.save(tmp_path / "volume.nii.gz")
    image = nibabel.load(tmp_path / "volume.nii.gz")
    values = np.asarray(image.dataobj)
    places = 1e-3 * (np.indices(values.shape).reshape(3, -1).T @ image.affine[:3, :3].T + image.affine[:3, 3])
    low, high = np.array(BOX.ranges).T
    inside = ((places >= low - 1e-9) & (places <= high + 1e-9)).all(axis=1).reshape(values.shape)
    (found,) = region_statistics(VOLUME, [BOX])
    assert found.voxels == inside.sum() == 11 * 10 * 11
    np.testing.assert_allclose(
        [found.mean, found.deviation, found.maximum, found.percentiles[95]],
        [values[inside].mean(), values[inside].std(), values[inside].max(), np.percentile(values[inside], 95)],
        rtol=1e-5,
    )
    assert found.size == pytest.approx(found.voxels * np.prod(STEP))


def test_ellipsoid_and_polygon_have_the_sizes_of_their_formulae():
    fine = Volume(np.ones((80, 80, 80), np.float32), VoxelAxes(*3 * (25e-6 * np.arange(80),)), 3 * (25e-6,))
    ball = Ellipsoid("ball", (1e-3, 1e-3, 1e-3), (0.8e-3, 0.6e-3, 0.4e-3))
    triangle = Polygon("triangle", "z", ((0.2e-3, 0.2e-3), (1.6e-3, 0.2e-3), (0.2e-3, 1.2e-3)), (0.5e-3, 1.0e-3))
    found = region_statistics(fine, [ball, triangle])
    assert found[0].size == pytest.approx(4 / 3 * np.pi * 0.8e-3 * 0.6e-3 * 0.4e-3, rel=0.02)
    assert found[1].size == pytest.approx(0.5 * 1.4e-3 * 1.0e-3 * 0.525e-3, rel=0.05)


def test_threshold_contrast_and_empty_voxels():
    values = np.where(np.arange(40) < 20, VALUES, 10 + VALUES)
    values[0, 0, 0] = np.nan
    volume = Volume(values, AXES, STEP)
    whole = Box("whole", tuple((line[0], line[-1]) for line in (AXES.x, AXES.y, AXES.z)))
    shallow = Box("shallow", (*whole.ranges[:2], (0.0, 0.96e-3)))
    deep = AboveThreshold("deep", Box("below", (*whole.ranges[:2], (0.99e-3, 2e-3))), 0.5)
    all_of_it, below = region_statistics(volume, [whole, deep], background=shallow)
    assert all_of_it.voxels == values.size - 1
    assert below.voxels == values[..., 20:].size
    noise = values[..., :20][np.isfinite(values[..., :20])]
    assert below.contrast_to_noise == pytest.approx((values[..., 20:].mean() - noise.mean()) / noise.std(), rel=1e-4)
    assert below.row()["percentile_50"] == below.percentiles[50]


@pytest.mark.parametrize(
    ("region", "told"),
    [
        (Box("a", ((0, 1e-3), (0, 1e-3))), "a is 2 axes; allowed: 3: x, y, z"),
        (Box("a", ((1e-3, 0), (0, 1e-3), (0, 1e-3))), "a rising range"),
        (Box("a", ((5, 6), (0, 1e-3), (0, 1e-3))), "a is no voxel with a value"),
        (Ellipsoid("a", (0, 0, 0), (1e-3, 0, 1e-3)), "3 lengths above 0 m"),
        (Polygon("a", "t", ((0, 0), (1, 0), (0, 1)), (0, 1)), "a is axis t"),
        (Polygon("a", "z", ((0, 0), (1, 0)), (0, 1)), "a is 2 corners; allowed: at least 3"),
        (AboveThreshold("a", BOX, 1.5), "a is 1.5; allowed: a share from 0 to 1"),
    ],
)
def test_wrong_regions_are_refused_by_name(region, told):
    with pytest.raises(InvalidInput, match=told):
        region_statistics(VOLUME, [region])
