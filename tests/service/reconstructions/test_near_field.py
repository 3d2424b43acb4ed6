"""The sensors' own noise does not outshine the object on pictures of a first scan."""

import json

import numpy as np
import pytest

import steradian
from steradian.imaging import Display, Volume, VoxelAxes
from steradian.phantoms import Balls, add_noise, pressure
from steradian.reconstructions.volumes.images import draw_depth_coded, draw_mip
from steradian.reconstructions.volumes.near_field import crop_depth, near_field_depth
from steradian.reconstructions.volumes.projections import project, project_below_depth

MASK = steradian.equi_steradian_mask(8e-3, 2e-3, 400)
BALLS = Balls(np.array([[1e-3, 0.5e-3, 2e-3], [-1e-3, 0.0, 2.4e-3]]), np.full(2, 100e-6), np.ones(2))
SAMPLING = {"sampling_interval": 20e-9, "sound_speed": 1500.0}


def image(noise, mask=MASK, balls=BALLS):
    traces = pressure(balls, mask.positions, samples=256, **SAMPLING)
    traces = add_noise(traces, noise) if noise else traces
    acquisition = steradian.Acquisition(
        traces, mask, dt=SAMPLING["sampling_interval"], sound_speed=SAMPLING["sound_speed"]
    )
    return steradian.reconstruct(acquisition, steradian.ImageGrid(100))


def test_near_field_noise_brighter_than_object_is_cropped():
    """Of everything the brightest place is right below a sensor; from the near field's end on it is a ball."""
    volume = image(12)
    brightest = np.unravel_index(volume.values.argmax(), volume.values.shape)
    assert volume.axes.z[brightest[2]] < 0.6e-3
    depth = near_field_depth(volume, MASK.positions)
    assert 0.2e-3 < depth < 1.2e-3
    beyond = crop_depth(volume, depth)
    assert beyond.axes.z[0] == depth
    assert np.shares_memory(beyond.values, volume.values)
    place = np.unravel_index(beyond.values.argmax(), beyond.values.shape)
    found = [axis[i] for axis, i in zip((beyond.axes.x, beyond.axes.y, beyond.axes.z), place, strict=True)]
    assert np.linalg.norm(BALLS.centres - found, axis=1).min() < 150e-6


def test_it_grows_with_the_spacing_of_the_sensors():
    coarse = steradian.equi_steradian_mask(8e-3, 2e-3, 120)
    assert near_field_depth(image(12, coarse), coarse.positions) > near_field_depth(image(26), MASK.positions)


def test_near_field_depth_keeps_shallow_object():
    """Where it is the object that is bright, nothing is left out."""
    random = np.random.default_rng(1)
    centres = np.column_stack([random.uniform(-3e-3, 3e-3, (300, 2)), np.full(300, 0.3e-3)])
    near = Balls(centres, np.full(300, 100e-6), np.ones(300))
    assert near_field_depth(image(40, balls=near), MASK.positions) < 0.3e-3


@pytest.mark.parametrize("values", ["noise", "zeros"])
def test_sensors_above_every_voxel_do_not_stand_out(values):
    x = 1e-4 * np.arange(-8, 8)
    shape = (16, 16, 20)
    block = np.random.default_rng(0).normal(size=shape) if values == "noise" else np.zeros(shape)
    volume = Volume(block, VoxelAxes(x, x, 5e-5 * np.arange(20)), (1e-4, 1e-4, 5e-5))
    positions = np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)
    assert near_field_depth(volume, positions) == 0
    assert near_field_depth(volume, positions[:1]) == 0


def test_project_below_depth_matches_separate_projections():
    values = np.random.default_rng(3).normal(size=(6, 7, 9))
    axes = [1e-3 * np.arange(n, dtype=float) for n in values.shape]
    volume = Volume(values, VoxelAxes(*axes), (1e-3,) * 3)
    for depth, first in ((0.0, 0), (2.5e-3, 3), (4e-3, 4), (1.0, 8)):
        shown, everything = project_below_depth(volume, depth)
        for axis, number in zip("xyz", range(3), strict=True):
            np.testing.assert_array_equal(shown[axis], values[..., first:].max(axis=number))
            np.testing.assert_array_equal(everything[axis], project(volume)[axis])


def test_scales_end_at_the_percentile_but_not_below_half_the_maximum(tmp_path):
    """1,000 values 0 … 999 of one hot pixel each; a lone bright voxel keeps its shape."""
    x, z = 1e-4 * np.arange(40.0), 1e-4 * np.arange(25.0)
    steps = Volume(np.arange(1000.0).reshape(40, 25), VoxelAxes(x, None, z), (1e-4, 1e-4))
    for percentile in (99.9, 90.0, 60.0):
        drawn = draw_mip(steps, "y", tmp_path / "a.png", Display(percentile=percentile))
        assert drawn.highest == pytest.approx(9.99 * percentile)
    lone = Volume(np.where(steps.values == 500, 8.0, 0.1), steps.axes, steps.spacing)
    assert draw_mip(lone, "y", tmp_path / "a.png", Display(percentile=90)).highest == 4
    texts = [text for text, _ in draw_mip(lone, "y", tmp_path / "a.png", Display(percentile=90)).labels]
    assert any("half the maximum" in text for text in texts)
    decibels = Display(log_range_db=40, percentile=50)
    assert draw_mip(decibels.apply(lone), "y", tmp_path / "a.png", decibels).highest == -6


def test_colours_and_bar_can_be_chosen(tmp_path):
    from PIL import Image

    x = 1e-4 * np.arange(40.0)
    flat = Volume(np.ones((40, 40, 3), np.float32), VoxelAxes(x, x, x[:3]), (1e-4,) * 3)
    for name, bright in (("gray", (255, 255, 255)), ("viridis", (253, 231, 37))):
        drawn = draw_mip(flat, "z", tmp_path / "a.png", Display(colour_map=name))
        left, top, _, _ = drawn.frame
        assert Image.open(tmp_path / "a.png").getpixel((left + 5, top + 5)) == bright
    for wanted, text in ((None, "1 mm"), (5e-4, "500 µm"), (2e-3, "2 mm")):
        labels = [label for label, _ in draw_depth_coded(flat, tmp_path / "a.png", Display(scale_bar=wanted)).labels]
        assert text in labels
    without = [label for label, _ in draw_mip(flat, "z", tmp_path / "a.png", Display(scale_bar=0)).labels]
    assert not any(label.endswith("mm") for label in without)


@pytest.mark.parametrize(
    "wrong",
    [
        {"near_field": -1e-3},
        {"near_field": 3.0},
        {"percentile": 40},
        {"colour_map": "jet"},
        {"size": 9},
        {"scale_bar": -1},
    ],
)
def test_nonsense_is_refused(wrong):
    with pytest.raises(steradian.InvalidInput) as refused:
        Display(**wrong)
    assert refused.value.field == next(iter(wrong))


def test_the_report_states_depth_and_scale(tmp_path):
    """The job measures the near field, leaves it out of the pictures, keeps it in the volume, and says so."""
    from steradian.reconstructions.pipeline.run import reconstruct_scan
    from steradian.reconstructions.volumes.file import read_projection, read_volume

    dx = 1e-4
    traces = add_noise(pressure(BALLS, MASK.positions, samples=256, **SAMPLING), 12)
    np.savez(
        tmp_path / "scan.npz",
        sensor_data=traces,
        positions=MASK.positions,
        sampling_interval=20e-9,
        sound_speed=1500.0,
        aperture=8e-3,
    )
    report = reconstruct_scan(tmp_path / "scan.npz", tmp_path / "out")
    told = json.loads((tmp_path / "out" / "report.json").read_text())
    volume = read_volume(tmp_path / "out" / "volume.h5")
    assert told["near_field_m"] == report.near_field_m == near_field_depth(volume, MASK.positions) > 2 * dx
    assert told["scale_percentile"] == 99.9
    assert set(told["scale_ends"]) == {"x", "y", "z"}
    np.testing.assert_array_equal(read_projection(tmp_path / "out" / "volume.h5", "z"), volume.mip("z"))
    assert told["scale_ends"]["z"] < volume.mip("z").max()
