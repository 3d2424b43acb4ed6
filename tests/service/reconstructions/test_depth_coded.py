"""The depth-coded projection: colours tell the depth, brightness the pressure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from steradian import InvalidInput
from steradian.drawing.image_figure import Layout
from steradian.imaging import Volume, VoxelAxes
from steradian.imaging.signal.conditioning import Display
from steradian.reconstructions.volumes.images import draw_depth_coded


def volume() -> Volume:
    """A near and a far spot of the same height, and a weak one in between."""
    values = np.zeros((30, 20, 40), np.float32)
    values[3:7, 3:7, 5] = 1
    values[23:27, 13:17, 35] = 1
    values[13:17, 8:12, 20] = 0.3
    x, y, z = 1e-4 * (np.arange(30.0) - 15), 1e-4 * (np.arange(20.0) - 10), 1e-3 + 5e-5 * np.arange(40.0)
    return Volume(values, VoxelAxes(x, y, z), (1e-4, 1e-4, 5e-5))


def spot(path: Path, drawn: Layout, x: int, y: int) -> tuple[int, ...]:
    """Colour at voxel x, y; the picture is 720 pixels wide for 30 voxels, y points up."""
    left, top, _, _ = drawn.frame
    return Image.open(path).convert("RGB").getpixel((left + int((x + 0.5) * 24), top + int((20 - y - 0.5) * 24)))


def test_near_is_warm_far_is_cold_weak_is_dark_and_nothing_is_black(tmp_path) -> None:
    path = tmp_path / "mip-depth.png"
    drawn = draw_depth_coded(volume(), path)
    near, far, weak, nothing = (spot(path, drawn, *place) for place in ((5, 5), (25, 15), (15, 10), (20, 3)))
    assert near[0] > 120 > near[2]
    assert far[2] > 120 > far[0]
    assert 20 < max(weak) < 0.4 * 255
    assert nothing == (0, 0, 0)
    assert list(tmp_path.iterdir()) == [path]


def test_decibels_are_black_at_their_least(tmp_path) -> None:
    display = Display(log_range_db=30.0)
    drawn = draw_depth_coded(display.apply(volume()), tmp_path / "a.png", display)
    assert spot(tmp_path / "a.png", drawn, 20, 3) == (0, 0, 0)
    assert max(spot(tmp_path / "a.png", drawn, 15, 10)) > 0.5 * 255


def test_an_empty_volume_is_drawn_black(tmp_path) -> None:
    empty = volume()
    empty.values[:] = 0
    drawn = draw_depth_coded(empty, tmp_path / "a.png")
    assert spot(tmp_path / "a.png", drawn, 5, 5) == (0, 0, 0)


def test_an_image_below_a_line_has_no_columns_to_look_down(tmp_path) -> None:
    axis = 1e-4 * np.arange(4.0)
    with pytest.raises(InvalidInput):
        draw_depth_coded(Volume(np.ones((4, 4)), VoxelAxes(axis, None, axis), (1e-4, 1e-4)), tmp_path / "a.png")
