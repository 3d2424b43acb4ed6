"""The 3-D view is what rays through the numbers give: NumPy's maxima, at places that trigonometry says."""

import math

import numpy as np
import pytest

from support.page_modules import modules_of

MODULE = "volume/raycast.js"
SIZE = 160
WHOLE = [0, 1, 0, 1, 0, 1]
SPACING, ORIGIN = (0.1, 0.08, 0.05), (-1.0, -0.72, 0.4)
SCRIPT = """
    const colours = await import("/static/volume/colours.js");
    const canvas = Object.assign(document.createElement("canvas"), {width: given.size, height: given.size});
    const block = {...given.block, values: Float32Array.from(given.block.values)};
    const picture = m.createRaycaster(canvas, {keep: true});
    if (!picture) return "no WebGL 2";
    picture.upload(block);
    picture.draw({...given.shown, colours: colours.colourTable(given.shown.map)});
    const gl = canvas.getContext("webgl2");
    const bytes = new Uint8Array(4 * given.size ** 2);
    gl.readPixels(0, 0, given.size, given.size, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    const at = m.projection(block, given.shown.camera, canvas, given.shown.fit);
    return {pixels: [...bytes], scale: at.scale, places: given.places.map((place) => at.project(place))};
"""


@pytest.fixture(scope="module")
def modules(chromium, service):
    with modules_of(chromium, service) as modules:
        yield modules


def blobs(*places, shape=(21, 19, 41), sigma=0.12):
    """Gaussian blobs at places in mm."""
    axes = [o + s * np.arange(n) for o, s, n in zip(ORIGIN, SPACING, shape, strict=True)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    return sum(np.exp(-((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2) / (2 * sigma**2)) for a, b, c in places)


def draw(modules, values, camera=(0, 90, 1), clip=WHOLE, map="grey", window=(0, 1), depth=False, places=(), **more):
    block = {"values": values.ravel(), "shape": values.shape, "origin": ORIGIN, "spacing": SPACING}
    shown = {"camera": camera, "clip": clip, "window": window, "depth": depth, "map": map, "depths": [0.4, 2.4]} | more
    found = modules.call(MODULE, SCRIPT, block=block, shown=shown, size=SIZE, places=places)
    assert isinstance(found, dict), found
    pixels = np.array(found["pixels"], np.uint8).reshape(SIZE, SIZE, 4)[::-1, :, :3]  # WebGL's first row is the lowest
    return pixels, found


def brightest(pixels):
    row, column = np.unravel_index(pixels.astype(int).sum(axis=2).argmax(), pixels.shape[:2])
    return column + 0.5, row + 0.5


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 90), (0, 0), (-35, 25), (120, -60), (200, 10)])
def test_a_blob_appears_where_it_is(modules, azimuth, elevation):
    """The brightest pixel is where an orthographic projection, worked out by itself, has the blob's centre."""
    place = np.array([0.42, 0.31, 1.7])
    pixels, found = draw(modules, blobs(place), (azimuth, elevation, 1), places=[place])
    a, e = math.radians(azimuth), math.radians(elevation)
    into = np.array([math.sin(a) * math.cos(e), -math.cos(a) * math.cos(e), math.sin(e)])
    right = np.array([math.cos(a), math.sin(a), 0.0])
    up = np.cross(right, into)
    assert np.cross(right, up) == pytest.approx(-into), "the picture would be a mirror image"
    middle = np.array(ORIGIN) + (np.array([21, 19, 41]) - 1) / 2 * SPACING
    expected = SIZE / 2 + found["scale"] * np.array([right @ (place - middle), -(up @ (place - middle))])
    assert brightest(pixels) == pytest.approx(expected, abs=2)
    assert (found["places"][0]["x"], found["places"][0]["y"]) == pytest.approx(expected, abs=1e-6)


def test_looking_along_z_is_the_projection_along_z(modules):
    """From the sensors the picture is NumPy's maximum-intensity projection, y pointing down."""
    values = blobs((0.42, 0.31, 1.7), (-0.5, -0.3, 0.7)) * 0.8
    pixels, found = draw(modules, values, places=[(0, 0, 0)])
    mip = values.max(axis=2)
    for i, j in [(14, 12), (5, 5), (10, 9), (14, 9)]:
        x = SIZE / 2 + found["scale"] * (ORIGIN[0] + i * SPACING[0])
        y = SIZE / 2 + found["scale"] * (ORIGIN[1] + j * SPACING[1] - (ORIGIN[1] + 9 * SPACING[1]))
        assert pixels[int(y), int(x), 0] / 255 == pytest.approx(mip[i, j], abs=0.04)


def test_a_length_in_the_picture_is_as_long_as_in_the_volume(modules):
    """Two blobs 1.2 mm apart lie 1.2 times the scale apart, from wherever one looks across them."""
    one, other = (-0.6, 0.0, 1.4), (0.6, 0.0, 1.4)
    first, found = draw(modules, blobs(one), (0, 30, 1.5))
    second, _ = draw(modules, blobs(other), (0, 30, 1.5))
    apart = np.subtract(brightest(second), brightest(first))
    assert apart[0] / found["scale"] == pytest.approx(1.2, rel=0.03)
    assert apart[1] == 0


def test_raycast_hides_clipped_voxels(modules):
    near, far = (0.0, 0.0, 0.8), (0.0, 0.0, 2.0)
    whole, _ = draw(modules, blobs(near, far) * [1.0], (0, 0, 1))
    below, found = draw(modules, blobs(near, far), (0, 0, 1), clip=[0, 1, 0, 1, 0.5, 1], places=[near, far])
    (seen,), (hidden,) = ([p] for p in reversed(found["places"]))
    assert whole[int(hidden["y"]), int(hidden["x"]), 0] > 240
    assert below[int(hidden["y"]), int(hidden["x"]), 0] == 0
    assert below[int(seen["y"]), int(seen["x"]), 0] > 240


def test_a_fitted_part_is_in_the_middle_and_fills_the_picture(modules):
    """Of the lower quarter of the depths the middle is in the picture's, at the scale of its diagonal."""
    place = np.array(ORIGIN) + (np.array([10, 9, 35]) * SPACING)
    pixels, found = draw(modules, blobs(place), (0, 0, 1), fit=[0, 1, 0, 1, 0.75, 1], places=[place])
    assert brightest(pixels) == pytest.approx((SIZE / 2, SIZE / 2), abs=3)
    extent = np.array([21, 19, 41 / 4]) * SPACING
    assert found["scale"] == pytest.approx(SIZE / 1.04 / np.linalg.norm(extent))


def test_depth_is_a_hue(modules):
    """A blob near the sensors is warm, one far from them is cold, in the colours of the service's own pictures."""
    near, far = (-0.5, 0.0, 0.6), (0.5, 0.0, 2.2)
    pixels, found = draw(modules, blobs(near, far), map="depth", depth=True, places=[near, far])
    warm, cold = (pixels[int(p["y"]), int(p["x"])].astype(int) for p in found["places"])
    assert warm[0] > warm[2] + 60
    assert cold[2] > cold[0] + 60


def test_the_window_and_the_colours_hold(modules):
    """Values are windowed in their own unit, however large they are."""
    values = blobs((0.0, 0.0, 1.4), sigma=0.3) * 5000
    pixels, _ = draw(modules, values, window=(0, 10000))
    assert pixels.max() == pytest.approx(127, abs=6)
    picture, _ = draw(modules, values, window=(0, 10000), transfer={"gamma": 0.5, "log": 0})
    assert picture.max() == pytest.approx(255 * 0.5**0.5, abs=6)
    picture, _ = draw(modules, values, window=(0, 10000), transfer={"gamma": 1, "log": 40})
    assert picture.max() == pytest.approx(255 * (1 + np.log10(0.5) / 2), abs=6)
    signed, _ = draw(modules, -values, map="difference", window=(-5000, 5000), places=[(0.0, 0.0, 1.4)])
    assert signed.max() < 20, "a maximum-intensity projection of negative values shows the highest of them: none"


def test_raycast_window_matches_slices_for_thin_structures(modules):
    """A wire that a coarse copy has at 0.3 of its brightness, as its voxels are means, has the whole of the colours."""
    wire = np.zeros((24, 24, 40), np.uint8)
    wire[:, 12, 25] = round(0.3 * 255)
    wire[:, :, 0] = 255  # the near field, which is left out
    block = {"values": wire.ravel(), "shape": wire.shape, "origin": ORIGIN, "spacing": SPACING, "window": [0, 8]}
    script = """
        given.block.values = Uint8Array.from(given.block.values);
        const solid = Object.create(m.View3D.prototype);
        Object.assign(solid, {stage: {cut: 0.5, projectedEnd: 8, window: [0, 8]}, block: given.block});
        solid.dimFactor = solid.dimFactorOf(given.block);
        return solid.window;"""
    assert modules.call("volume/view_3d.js", script, block=block) == pytest.approx([0, 0.3 * 255], rel=0.01)
