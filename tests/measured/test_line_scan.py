"""A measured line scan, from the file to the image by one command; run where STERADIAN_MEASURED_DATA names its folder.

The file is LineScan2D_PinsPlexiAluSDH.mat of the Synaptus toolbox (doi 10.21105/joss.04185): pulse-echo ultrasound of
four pins in water, 20 mm apart sideways and 5 mm in depth. As an exploding reflector, at half the speed of sound, it is
a photoacoustic record. Half the transducer, 3.0 mm, is the width to expect.
"""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.signal import hilbert

import steradian
from support.commands import run_here

FILE = "LineScan2D_PinsPlexiAluSDH.mat"
WATER = 1480.0
DESCRIPTION = {
    "array": "ptx",
    "axes": "time, point",
    "time_zero": 58,
    "times": "us",
    "grid": {"count": [111], "interval": [1]},
    "lengths": "mm",
    "sound_speed": WATER / 2,
}
DEPTHS = (50.9e-3, 55.5e-3, 60.4e-3, 65.8e-3)
"""Depths of the pins below the transducer's plane, in m."""
LAYERS = steradian.Medium(
    [steradian.Layer(WATER / 2, 73.3e-3), steradian.Layer(2730.0 / 2, 31e-3), steradian.Layer(6320.0 / 2)]
)
"""Water, acrylic and aluminium, as the file states them, at half their speeds."""


@pytest.fixture(scope="module")
def volume(tmp_path_factory):
    file = Path(os.environ["STERADIAN_MEASURED_DATA"]) / FILE
    folder = tmp_path_factory.mktemp("line")
    run_here("reconstruct", file, "-d", json.dumps(DESCRIPTION), "--modes", 111, "-o", "image", cwd=folder)
    return steradian.open(folder / "image" / "volume.h5")


def pin_near(volume, depth):
    """Return (x, z) of the largest envelope within 2 mm of a depth, and its -6 dB width along x, in m."""
    sizes = volume.values.shape
    x, z = (volume.origin[axis] + volume.spacing[axis] * np.arange(sizes[axis]) for axis in (0, 1))
    near = np.abs(z - depth) < 2e-3
    envelope = np.abs(hilbert(np.asarray(volume.values), axis=1))[:, near]
    across = envelope.max(axis=1)
    top, deep = int(across.argmax()), int(envelope.max(axis=0).argmax())
    half = across[top] / 2
    left = top - int(np.argmax(across[top::-1] < half))
    right = top + int(np.argmax(across[top:] < half))
    edges = [np.interp(half, across[i : i + 2][::way], x[i : i + 2][::way]) for i, way in ((left, 1), (right - 1, -1))]
    return x[top], z[near][deep], edges[1] - edges[0]


@pytest.mark.parametrize("depth", DEPTHS)
def test_measured_line_scan_shows_each_pin_at_its_depth_as_wide_as_half_the_transducer(volume, depth):
    _, z, width = pin_near(volume, depth)
    assert z == pytest.approx(depth, abs=0.3e-3)
    assert 3.0e-3 <= width <= 3.2e-3


def test_measured_line_scan_shows_the_pins_20_mm_apart(volume):
    x = [pin_near(volume, depth)[0] for depth in DEPTHS]
    np.testing.assert_allclose(np.diff(x), 20e-3, atol=1.1e-3)


@pytest.fixture(scope="module")
def layered():
    record = loadmat(Path(os.environ["STERADIAN_MEASURED_DATA"]) / FILE)["ptx"].T.astype(float)
    sensors = (np.arange(111) - 55) * 1e-3
    acquisition = steradian.Acquisition(record, sensors, dt=80e-9, t0=58e-6, medium=LAYERS, aperture=111e-3)
    grid = steradian.ImageGrid(modes=111, depth=(30e-3, 160e-3), lateral_padding=2.0)
    return steradian.reconstruct(acquisition, grid, steradian.Nufft(max_frequency=4e6))


@pytest.mark.parametrize("way", [0.95, 1.05])
def test_measured_line_scan_has_the_speed_of_each_layer_found_from_five_percent_off(way):
    record = loadmat(Path(os.environ["STERADIAN_MEASURED_DATA"]) / FILE)["ptx"].T.astype(float)
    layers = [steradian.Layer(way * layer.sound_speed, layer.thickness) for layer in LAYERS.layers]
    sensors = (np.arange(111) - 55) * 1e-3
    medium = steradian.Medium(layers)
    acquisition = steradian.Acquisition(record, sensors, dt=80e-9, t0=58e-6, medium=medium, aperture=111e-3)
    found = steradian.find_medium(acquisition, modes=111, standard_error=False)
    assert [each.criterion for each in found.parameters] == ["boundary echo", "boundary echo", "sharpness"]
    for each, layer in zip(found.parameters, LAYERS.layers, strict=True):
        assert each.value == pytest.approx(layer.sound_speed, rel=0.02)


def strongest(volume, low, high, apart):
    """Return (z, width at half of it along x) of the four largest envelopes in a depth range, ``apart`` in depth."""
    z = volume.coordinates("z")
    inside = (z > low) & (z < high)
    envelope = np.abs(hilbert(np.asarray(volume.values), axis=1))[:, inside]
    found = []
    for _ in range(4):
        depth = z[inside][envelope.max(axis=0).argmax()]
        found.append((depth, pin_near(volume, depth)[2]))
        envelope[:, np.abs(z[inside] - depth) < apart] = 0
    return np.array(sorted(found)).T


def test_measured_line_scan_shows_each_hole_in_acrylic_below_water(layered):
    depths, widths = strongest(layered, 76e-3, 101e-3, 3e-3)
    np.testing.assert_allclose(np.diff(depths), 6.0e-3, atol=0.2e-3)
    np.testing.assert_allclose(widths, 3.1e-3, atol=0.2e-3)


def test_measured_line_scan_shows_each_hole_in_aluminium_below_acrylic(layered):
    depths, _ = strongest(layered, 108e-3, 150e-3, 6e-3)
    np.testing.assert_allclose(np.diff(depths), 10e-3, atol=1e-3)
