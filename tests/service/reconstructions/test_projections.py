"""Projections, their pictures, and plans that are kept from job to job."""

import numpy as np
import pytest
from PIL import Image

from steradian.drawing.image_figure import SHORT_SIDE
from steradian.drawing.ticks import ticks
from steradian.imaging import Volume, VoxelAxes
from steradian.imaging.engines.cuda import array_backend
from steradian.imaging.signal.conditioning import Display
from steradian.reconstructions.pipeline.plan_cache import PlanCache, deep_array_bytes
from steradian.reconstructions.volumes.images import draw_mip
from steradian.reconstructions.volumes.projections import project
from support.flat import flat_compute, flat_geometry, flat_grid, flat_method, flat_plan

OPTIONS = {
    "sampling_interval": 20e-9,
    "sound_speed": 1500.0,
    "aperture": 1e-3,
    "modes": 8,
    "weights": None,
    "method": "nedner",
}


def volume(shape, at=None):
    values = np.random.default_rng(0).normal(size=shape).astype(np.float32) if at is None else np.zeros(shape, "f4")
    if at is not None:
        values[at] = 1
    x = (np.arange(shape[0]) - shape[0] // 2) * 1e-3
    y = (np.arange(shape[1]) - shape[1] // 2) * 1e-3 if len(shape) == 3 else None
    return Volume(values, VoxelAxes(x, y, np.arange(shape[-1]) * 1e-3), (1e-3,) * len(shape))


def test_one_pass_gives_the_projections_along_every_axis():
    image = volume((5, 7, 9))
    for axis, projected in project(image).items():
        np.testing.assert_array_equal(projected, image.mip(axis))
    flat = volume((5, 9))
    np.testing.assert_array_equal(project(flat)["y"], flat.values)


@pytest.mark.parametrize("decibels", [None, 60.0, 60.1])
def test_an_image_of_nothing_is_drawn_black(tmp_path, decibels):
    nothing = volume((10, 10, 10), (8, 8, 7))
    nothing.values[:] = 0
    display = Display(log_range_db=decibels)
    path = tmp_path / "mip.png"
    left, top, right, bottom = draw_mip(display.apply(nothing), "z", path, display).frame
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("L"))[top:bottom, left:right]
    assert np.median(pixels) < 10


@pytest.mark.parametrize(
    ("axis", "across", "down"),
    [("z", 8 / 10, 1 / 10), ("x", 8 / 10, 7 / 10), ("y", 8 / 10, 7 / 10)],
)
def test_a_bright_voxel_is_right_of_the_middle_above_it_and_deep(tmp_path, axis, across, down):
    """x and y grow to the right and up, depth grows downwards."""
    path = tmp_path / "mip.png"
    left, top, right, bottom = draw_mip(volume((10, 10, 10), (8, 8, 7)), axis, path).frame
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("L"))[top:bottom, left:right]
    side = right - left
    step = side // 10
    top, left = round(down * side), round(across * side)
    bright = pixels[top : top + step, left : left + step]
    assert bright.min() > 200
    others = pixels[:, side // 2 :].astype(int)  # the scale bar is in the other half
    assert (others > 200).sum() == bright.size
    assert list(tmp_path.iterdir()) == [path], "no draft is left"


@pytest.mark.parametrize("shape", [(3, 200, 4), (200, 3, 5), (2, 2, 2), (6, 300)])
@pytest.mark.parametrize("display", [Display(), Display(log_range_db=40)])
def test_any_shape_and_display_can_be_drawn(tmp_path, shape, display):
    image = display.apply(volume(shape))
    for axis in project(image):
        draw_mip(image, axis, tmp_path / f"{axis}.png", display)
        with Image.open(tmp_path / f"{axis}.png") as picture:
            assert min(picture.size) > SHORT_SIDE


def test_an_image_of_nothing_can_be_drawn(tmp_path):
    draw_mip(volume((4, 4, 4), ()), "z", tmp_path / "mip.png")
    empty = volume((4, 4, 4), (0, 0, 0))
    empty.values[:] = 0
    draw_mip(empty, "z", tmp_path / "mip.png")


@pytest.mark.parametrize("span", [(0, 12.3), (-6.78, 6.78), (0, 1e-9), (-40, 0), (0, 3e7)])
def test_ticks_are_round_and_within(span):
    found = ticks(*span)
    assert 3 <= len(found) <= 10
    slack = 1e-5 * (span[1] - span[0])
    assert min(found) >= span[0] - slack
    assert max(found) <= span[1] + slack
    assert len({f"{tick:g}" for tick in found}) == len(found)


@pytest.fixture
def positions():
    return np.random.default_rng(2).uniform(-4e-4, 4e-4, (20, 2))


def arguments(positions, samples, **flat):
    """Return geometry, grid, method and execution options."""
    geometry, grid = flat_geometry(positions, samples, flat), flat_grid(flat)
    return geometry, grid, flat_method(flat), flat_compute(flat)


def test_the_same_geometry_finds_its_plan_again_and_gives_the_same_image(positions):
    plans, traces = PlanCache(), np.random.default_rng(3).normal(size=(20, 32)).astype(np.float32)
    plan = plans.get(*arguments(positions, 32, **OPTIONS))
    assert plans.get(*arguments(positions.copy(), 32, **OPTIONS)) is plan
    first, again = plan.run(traces).values.copy(), plan.run(traces).values
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first, flat_plan(positions, samples=32, **OPTIONS).run(traces).values)


@pytest.mark.parametrize(
    "change",
    [{"sound_speed": 1501.0}, {"modes": 9}, {"weights": 1e-8 * np.linspace(1, 2, 20)}, {"method": "linear"}],
    ids=lambda change: next(iter(change)),
)
def test_another_geometry_gets_another_plan(positions, change):
    plans = PlanCache()
    plan = plans.get(*arguments(positions, 32, **OPTIONS))
    assert plans.get(*arguments(positions, 32, **OPTIONS | change)) is not plan
    assert plans.get(*arguments(positions + 1e-9, 32, **OPTIONS)) is not plan
    assert plans.get(*arguments(positions, 33, **OPTIONS)) is not plan


def test_plan_cache_evicts_by_count_and_memory(positions):
    plans = PlanCache(most=2)
    speeds = [arguments(positions, 32, **OPTIONS | {"sound_speed": speed}) for speed in (1400.0, 1500.0, 1600.0)]
    first, second, _ = (plans.get(*options) for options in speeds)
    assert len(plans) == 2
    assert plans.get(*speeds[1]) is second
    assert plans.get(*speeds[0]) is not first
    tight = PlanCache(most_bytes=1)
    for options in speeds:
        tight.get(*options)
    assert len(tight) == 1


def test_plan_cache_rebuilds_plan_after_gpu_memory_fallback(positions, monkeypatch):
    """The next job may find room there, and does not report what befell another one."""
    monkeypatch.setenv(array_backend.USE_SIMULATOR, "simulator")
    monkeypatch.setattr(array_backend.SimulatorBackend, "free", lambda _: 1000)
    plans, options = PlanCache(), arguments(positions, 32, **OPTIONS, device="auto")
    assert plans.get(*options).chosen.device == "cpu"
    monkeypatch.undo()
    monkeypatch.setenv(array_backend.USE_SIMULATOR, "simulator")
    plan = plans.get(*options)
    assert (plan.chosen.device, plan.chosen.notes) == ("simulator", [])
    assert plans.get(*options) is plan


def test_shared_arrays_count_once():
    class Thing:
        pass

    Thing.__module__ = "steradian.test"
    thing, array = Thing(), np.zeros(1000)
    thing.parts = [array, array[:10], {"again": array}, "text"]
    assert deep_array_bytes(thing) == array.nbytes
