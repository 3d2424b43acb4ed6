"""Figures for papers and films: sizes, colours, axes and names, read back by other programs."""

import re

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib import pyplot as plt
from PIL import Image

from steradian import InvalidInput, Volume
from steradian.imaging import VoxelAxes
from steradian.reconstructions.display import draw_volumes
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.series.series import Series
from steradian.reconstructions.volumes.panels import ColourScale, Panel
from support.commands import run_here

STEP = (100e-6, 100e-6, 50e-6)
AXES = VoxelAxes(100e-6 * (np.arange(30) - 15), 100e-6 * (np.arange(20) - 10), 1e-3 + 50e-6 * np.arange(40))


def volume(height=1.0):
    """A bright block near the film, a weaker one deep, off the middle in each axis."""
    values = np.zeros((30, 20, 40), np.float32)
    values[3:9, 2:6, 5] = height
    values[20:26, 12:18, 30] = 0.5 * height
    return Volume(values, AXES, STEP, 1500.0)


SERIES = Series([SeriesFrame((n,), 750e-9, 0.5 * n) for n in range(3)], lambda n: volume(1.0 + n))


def colour_at(path, x, y, width=85.0, dpi=300.0, bars=1):
    """Colour of a PNG at x, y in mm of the panel of one volume on a page 85 mm wide."""
    with Image.open(path) as drawn:
        pixels = np.asarray(drawn.convert("RGB"))
    wide = width - 11 - 17.5 * bars
    high = wide * 20 / 30
    across, up = 11 + wide * (x + 1.55) / 3, 9 + high * (y + 1.05) / 2
    return pixels[pixels.shape[0] - round(up / 25.4 * dpi), round(across / 25.4 * dpi)].tolist()


def test_png_has_the_stated_size_and_the_colours_of_the_values(tmp_path):
    path = volume().figure(tmp_path / "a.png", percentile=100, scale_bar=0)
    with Image.open(path) as drawn:
        assert drawn.width == pytest.approx(85 / 25.4 * 300, abs=1)
        assert drawn.info["dpi"][0] == pytest.approx(300, abs=0.1)
    scale = (255 * colormaps["inferno"]([1.0, 0.5, 0.0])[:, :3]).round().astype(int)
    for place, expected in (((-0.95, -0.65), scale[0]), ((0.75, 0.45), scale[1]), ((0.0, 0.0), scale[2])):
        np.testing.assert_allclose(colour_at(path, *place), expected, atol=2)


def test_depth_coded_figure_has_warm_near_and_cold_far(tmp_path):
    path = volume().figure(tmp_path / "a.png", depth_coded=True, percentile=100, scale_bar=0)
    near, far = colour_at(path, -0.95, -0.65), colour_at(path, 0.75, 0.45)
    assert near[0] > near[2]
    assert far[2] > far[0]


@pytest.mark.long
def test_pdf_has_the_stated_page_and_truetype_letters(tmp_path):
    content = SERIES[:2].figure(tmp_path / "a.pdf", width=170).read_bytes()
    box = [float(each) for each in re.search(rb"/MediaBox\s*\[([^\]]+)\]", content)[1].split()]
    assert box[2] == pytest.approx(170 / 25.4 * 72, abs=0.5)
    assert b"/FontFile2" in content or b"/CIDFontType2" in content
    assert b"/Type3" not in content
    assert content.count(b"/Subtype /Image") >= 3  # two panels and the colour bar
    assert SERIES[:2].figure(tmp_path / "b.pdf", width=170).read_bytes() == content


def test_svg_has_vector_axes_and_size_in_points(tmp_path):
    text = volume().figure(tmp_path / "a.svg", name="before", label="pressure (Pa)").read_text()
    assert float(re.search(r'<svg[^>]* width="([\d.]+)pt"', text)[1]) == pytest.approx(85 / 25.4 * 72, abs=0.5)
    assert text.count("<image") == 2
    assert text.count("<path") > 20
    for word in ("<!-- before -->", "<!-- x (mm) -->", "<!-- y (mm) -->", "<!-- pressure (Pa) -->"):
        assert word in text
    assert len(volume().figure(tmp_path / "b.svg", name="before", scale_bar=0).read_text()) < len(text) - 300


def test_panels_share_the_scale_of_the_brightest():
    panels = [Panel.of(each) for each in SERIES]
    scale = ColourScale.of(panels, percentile=100)
    assert (scale.lowest, scale.highest) == (0, 3)
    assert scale.share(panels[0].image).max() == pytest.approx(1 / 3)
    assert ColourScale.of(panels, limits=(-1, 1)).share(np.array([0.0])) == [0.5]


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_projection_is_that_of_numpy_with_depth_downwards(axis):
    found, values = Panel.of(volume(), axis), volume().values
    expected = values.max(axis="xyz".index(axis)).T
    np.testing.assert_array_equal(found.image, expected if axis == "z" else expected[::-1])
    assert found.up == pytest.approx((-1.05, 0.95) if axis == "z" else (2.975, 0.975))
    if axis == "z":
        assert found.depths[13, 22] == pytest.approx(2.5)


def test_slab_and_region_are_the_voxels_between_their_positions():
    """The maximum is over a slab, of one position the nearest slice; the shown part ends at the edges of voxels."""
    values = np.random.default_rng(0).random((30, 20, 40)).astype(np.float32)
    image = Volume(values, AXES, STEP)
    found = Panel.of(image, "y", slab=(-0.3e-3, 0.25e-3), region={"x": (-1e-3, 0.5e-3), "z": (1.2e-3, 2e-3)})
    np.testing.assert_array_equal(found.image, values[5:21, 7:13, 4:21].max(axis=1).T[::-1])
    assert (found.across, found.up) == (pytest.approx((-1.05, 0.55)), pytest.approx((2.025, 1.175)))
    near = Panel.of(image, "z", slab=(1.21e-3, 1.21e-3), near_field=2e-3)
    np.testing.assert_array_equal(near.image, values[:, :, 4].T)
    for slab in ((1e-3, 0.0), (5e-3, 6e-3)):
        with pytest.raises(InvalidInput, match="range along z"):
            Panel.of(image, "z", slab=slab)


@pytest.mark.parametrize("transfer", [{"gamma": 0.5}, {"log_range_db": 40.0}])
def test_gamma_and_logarithm_change_panels_and_colour_bar_alike(transfer):
    share = np.linspace(0, 1, 11)[None]
    scale = ColourScale(0.0, 2.0, "", "gray", **transfer)
    expected = share**0.5 if "gamma" in transfer else np.clip(1 + np.log10(np.maximum(share, 1e-9)) / 2, 0, 1)
    np.testing.assert_allclose(scale.share(2 * share), expected, atol=1e-6)
    signed = ColourScale(-1.0, 1.0, "", "coolwarm", **transfer)
    np.testing.assert_allclose(signed.share(share), 0.5 + expected / 2, atol=1e-6)
    np.testing.assert_allclose(signed.share(-share), 0.5 - expected / 2, atol=1e-6)


def test_panels_of_several_axes_have_one_scale_of_length(tmp_path):
    """A millimetre is as long in each panel, also where extents differ; letters have the stated points."""
    path = volume().figure(tmp_path / "a.png", axis=("z", "y"), scale_bar=0, limits=(0, 1), colour_map="cyan")
    with Image.open(path) as drawn:
        pixels = np.asarray(drawn.convert("RGB"))
    bright = np.flatnonzero((pixels == [0, 255, 255]).all(axis=2).any(axis=0))
    first, second = np.split(bright, np.flatnonzero(np.diff(bright) > 1) + 1)[:2]  # the colour bar may follow
    assert len(first) == pytest.approx(len(second), abs=2)
    assert len(first) > 20
    for size in (7, 9):
        text = volume().figure(tmp_path / "a.svg", font_size=size).read_text()
        assert f"scale({size / 100:g} -{size / 100:g})" in text


def test_overlay_adds_the_colours_of_a_volume_of_other_voxels(tmp_path):
    """Red of the first and half of the cyan of the second volume, which has larger voxels and ends in the middle."""
    path, axes = tmp_path / "a.png", VoxelAxes(200e-6 * (np.arange(8) - 7), AXES.y, AXES.z)
    other = Volume(np.ones((8, 20, 40), np.float32), axes, (200e-6, *STEP[1:]))
    shown = {"scale_bar": 0, "limits": (0, 1), "colour_map": "red", "width": 104}
    own = {"limits": (0, 1), "opacity": (1, 0.5), "label": "850 nm"}
    draw_volumes([(volume(), "")], path, overlay=other, overlay_options=own, **shown)
    both, second, first = ((-0.95, -0.65), [255, 128, 128]), ((-0.5, 0.5), [0, 128, 128]), ((0.75, 0.45), [128, 0, 0])
    for place, expected in (both, second, first):
        assert colour_at(path, *place, width=104.0, bars=2) == pytest.approx(expected, abs=2)
    with pytest.raises(InvalidInput, match="opacity"):
        draw_volumes([(volume(), "")], path, overlay=other, overlay_options={"opacity": (1, 2)}, **shown)


def test_overlay_that_reaches_one_of_two_slices_is_added_there_alone(tmp_path):
    """Its depths begin below the slice across z, which stays red."""
    path = tmp_path / "a.png"
    other = Volume(np.ones((30, 20, 40), np.float32), VoxelAxes(AXES.x, AXES.y, AXES.z + 10e-3), STEP)
    shown = {"scale_bar": 0, "limits": (0, 1), "colour_map": "red", "width": 104, "slab": {"z": (1e-3, 1e-3)}}
    own = {"limits": (0, 1), "opacity": (0.5, 1)}
    draw_volumes([(volume(), "")], path, overlay=other, overlay_options=own, axis=("z", "y"), **shown)
    with Image.open(path) as drawn:
        colours = {tuple(colour) for colour in np.asarray(drawn.convert("RGB")).reshape(-1, 3)}
    assert (128, 0, 0) in colours
    with pytest.raises(InvalidInput, match="overlay"):
        draw_volumes([(volume(), "")], path, overlay=other, overlay_options=own, **shown)


def test_page_that_a_narrow_region_would_make_too_high_is_refused(tmp_path):
    for options in ({"width": 85.0}, {"width": 60.0, "dpi": 2400}):
        with pytest.raises(InvalidInput, match=r"region.*mm high"):
            volume().figure(tmp_path / "a.png", region={"x": (0.0, 0.0)}, **options)
    assert not list(tmp_path.iterdir())


def test_plots_side_by_side_do_not_overlap():
    """Of two plots in a figure without a layout, no title or label lies in the room of the other."""
    figure, both = plt.subplots(1, 2)
    for axes, axis in zip(both, "zy", strict=True):
        volume().plot(axis, axes, cmap="coolwarm", vmin=-1, vmax=2, scale_bar=True)
    figure.canvas.draw()
    first, second = (axes.get_tightbbox() for axes in both)
    assert first.x1 <= second.x0
    shown = both[0].images[0]
    assert shown.get_clim() == (-1, 2)
    np.testing.assert_allclose(shown.cmap(0.7), colormaps["coolwarm"](0.7), atol=0.01)
    assert [text.get_text() for text in both[0].texts] == ["1 mm"]
    plt.close(figure)
    for wrong in ({"cmap": "none"}, {"vmin": 2, "vmax": 1}):
        with pytest.raises(InvalidInput):
            volume().plot(**wrong)


def test_values_that_are_missing_are_grey():
    values = np.full((30, 20, 40), np.nan, np.float32)
    values[5, 5, 5] = 0.7
    panel = Panel.of(Volume(values, AXES, STEP))
    painted = ColourScale.of([panel], limits=(0, 1), colour_map="coolwarm").paint(panel)
    assert painted[0, 0].tolist() == [200, 200, 200]
    np.testing.assert_allclose(painted[5, 5], 255 * np.array(colormaps["coolwarm"](0.7)[:3]), atol=1)
    deep = Panel.of(Volume(values[:, 5], VoxelAxes(AXES.x, None, AXES.z), STEP[::2]), near_field=1.1e-3)
    assert deep.image.shape == (38, 30)


def test_film_has_a_frame_for_each_volume_in_the_colours_of_one_scale(tmp_path):
    path = SERIES.film(tmp_path / "film.gif", interval=0.1, size=300, percentile=100)
    with Image.open(path) as film:
        assert film.n_frames == 3
        assert film.size == (300, 222)
        assert film.info["duration"] == 100
        assert film.info["loop"] == 0
        for number in range(3):
            film.seek(number)
            colour = film.convert("RGB").getpixel((55, 200 - 35))
            expected = 255 * np.array(colormaps["inferno"]((1 + number) / 3)[:3])
            np.testing.assert_allclose(colour, expected, atol=3)


def test_figure_command_writes_panels_and_film(tmp_path):
    SERIES.save(tmp_path / "series.h5")
    volume().save(tmp_path / "volume.h5")
    words = ("figure", "volume.h5", "series.h5", "--volumes", "0,2", "--width", "200mm", "--columns", "3")
    told = run_here(*words, "-o", "a.svg", cwd=tmp_path)
    assert "figure in a.svg" in told
    text = (tmp_path / "a.svg").read_text()
    assert "<!-- volume -->" in text
    assert "<!-- series: 750 nm, frame 2, 1 s -->" in text
    assert text.count("<image") == 4
    run_here("figure", "series.h5", "-o", "film.gif", "--size", "120", cwd=tmp_path)
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == 3


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("-o", "a.jpg"), "file is a.jpg; allowed: a name in .pdf, .svg, .png"),
        (("--axis", "w"), "axis is w; allowed: x, y, z"),
        (("--width", "20mm"), "width is 20.0; allowed: 30 to 1000 mm"),
        (("--volumes", "3"), "volumes is 3; allowed: numbers from 0 to 2"),
        (("--limits", "1"), "limits is 1; allowed: two numbers"),
        (("--limits", "1:0"), "limits is 1 to 0; allowed: two numbers that rise"),
        (("--colour-map", "mud"), "colour_map is mud"),
        (("--dpi", "5"), "dpi is 5.0; allowed: 50 to 2400"),
        (("--columns", "3", "--width", "40mm"), "columns is 3; allowed: at most what leaves panels 8 mm wide"),
        (("-o", "a.gif", "--depth-coded"), "depth_coded is true; allowed: false for a film"),
        (("-o", "a.gif", "--interval", "0"), "interval is 0.0; allowed: 0.02 to 10 s"),
    ],
)
def test_figure_command_refuses_with_field_and_range(tmp_path, words, told):
    SERIES.save(tmp_path / "series.h5")
    out = run_here("figure", "series.h5", *words, cwd=tmp_path, code=2)
    assert told in " ".join(out.split())
    assert not list(tmp_path.glob("a.*"))


def test_unknown_options_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match="colour is red; allowed: one of axis, near_field, slab, region, limits"):
        volume().figure(tmp_path / "a.pdf", colour="red")
