"""A volume as xarray: names, places in metres and units survive."""

import sys

import numpy as np
import pytest

from steradian import Volume
from steradian.imaging import VoxelAxes

VALUES = np.arange(2 * 3 * 4, dtype=np.float32).reshape(2, 3, 4)
AXES = VoxelAxes(x=np.array([-1e-4, 0.0]), y=np.array([-2e-4, 0.0, 2e-4]), z=np.array([1e-3, 1.1e-3, 1.2e-3, 1.3e-3]))


@pytest.mark.long
def test_a_volume_has_its_places_in_metres_and_shares_its_values():
    volume = Volume(VALUES, AXES, (1e-4, 2e-4, 1e-4), sound_speed=1500.0)
    image = volume.to_xarray()
    assert image.dims == ("x", "y", "z")
    assert np.shares_memory(image.values, VALUES)
    assert {name: image[name].units for name in image.dims} == {"x": "m", "y": "m", "z": "m"}
    assert image.z.long_name == "depth"
    assert image.sound_speed_m_s == 1500.0
    assert image.sel(x=0.0, y=2e-4, z=1.21e-3, method="nearest") == VALUES[1, 2, 2]
    assert float(image.interp(z=1.15e-3)[0, 0]) == pytest.approx((VALUES[0, 0, 1] + VALUES[0, 0, 2]) / 2)
    np.testing.assert_array_equal(image.max("z"), volume.mip("z"))


@pytest.mark.long
def test_an_image_below_a_line_has_two_dimensions():
    image = Volume(VALUES[:, 0], VoxelAxes(AXES.x, None, AXES.z), (1e-4, 1e-4)).to_xarray()
    assert image.dims == ("x", "z")
    assert "sound_speed_m_s" not in image.attrs


def test_to_xarray_without_xarray_names_install_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ImportError, match=r"pip install 'steradian\[notebook\]'"):
        Volume(VALUES, AXES, (1e-4, 2e-4, 1e-4)).to_xarray()
