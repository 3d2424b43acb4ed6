"""Colours are those that the service draws with, and the picture lies the right way round."""

import re

import numpy as np
import pytest

from steradian.drawing.style import colours, depth_colours
from support.page_modules import modules_of

MODULE = "volume/colours.js"


@pytest.fixture(scope="module")
def modules(chromium, service):
    with modules_of(chromium, service) as modules:
        yield modules


def rgb(pixels):
    values = np.asarray(pixels, np.int64)
    assert (values >> 24 == 255).all(), "not opaque"
    return np.stack([values & 255, values >> 8 & 255, values >> 16 & 255], axis=-1)


@pytest.mark.parametrize(
    ("name", "of"),
    [
        ("inferno", "inferno"),
        ("cividis", "cividis"),
        ("grey", "gray"),
        ("grey-reversed", "gray_r"),
        ("coolwarm", "coolwarm"),
    ],
)
def test_colour_tables_match_rendered_pictures(modules, name, of):
    """No colour is further than 4 of 255 from the one that the service's own pictures have."""
    found = rgb(modules.call(MODULE, f"return Array.from(m.colourTable('{name}'));"))
    assert np.abs(found - colours(of).astype(int)).max() <= 4


@pytest.mark.parametrize(("theme", "page"), [("light", (0xF4, 0xF6, 0xF8)), ("dark", (0x14, 0x1A, 0x21))])
def test_shades_stand_out_of_the_page(modules, theme, page):
    """Of lines and points no colour has a contrast below 3 to 1, WCAG 2's for what is not text."""
    script = "document.documentElement.dataset.theme = given.theme; return m.palette('cividis', 8);"
    found = modules.call("palette.js", script, theme=theme)
    rows = np.array([[int(one) for one in re.findall(r"\d+", colour)] for colour in (*found, f"rgb{page}")]) / 255
    light = np.where(rows <= 0.04045, rows / 12.92, ((rows + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722] + 0.05
    assert (np.maximum(light[:-1], light[-1]) / np.minimum(light[:-1], light[-1])).min() >= 3


@pytest.mark.parametrize(
    ("gamma", "decibels", "of"),
    [
        (0.5, 0, lambda share: share**0.5),
        (1, 40, lambda share: np.clip(1 + np.log10(np.maximum(share, 1e-9)) / 2, 0, 1)),
    ],
)
def test_gamma_and_logarithm_are_their_formulas(modules, gamma, decibels, of):
    """A share of 0.01 is black on a logarithmic scale of 40 dB; of signed values both sides have the curve."""
    script = (
        "return ['grey', 'coolwarm'].map((name) => [...m.transferTable(name, {gamma: given.gamma, log: given.log})]);"
    )
    grey, signed = modules.call("volume/transfer.js", script, gamma=gamma, log=decibels)
    share = np.linspace(0, 1, len(grey))
    assert np.abs(rgb(grey)[:, 0] - 255 * of(share)).max() <= 1
    both = 0.5 + 0.5 * np.sign(2 * share - 1) * of(np.abs(2 * share - 1))
    expected = colours("coolwarm")[np.round(255 * both).astype(int)].astype(int)
    assert np.abs(rgb(signed) - expected).max() <= 5


def test_depth_colour_table_matches_rendered_pictures(modules):
    found = rgb(modules.call(MODULE, "return Array.from(m.colourTable('depth'));"))
    assert np.abs(found - depth_colours().astype(int)).max() <= 1


def test_differences_are_dark_where_there_are_none(modules):
    """Lightness rises evenly to both sides of a dark middle; one side is blue, the other is not."""
    found = rgb(modules.call(MODULE, "return Array.from(m.colourTable('difference'));"))
    light = found @ [0.2126, 0.7152, 0.0722]
    assert light[127:129].max() < 5
    assert (np.diff(light[128:]) >= -0.5).all()
    assert (np.diff(light[127::-1]) >= -0.5).all()
    assert found[0, 2] > found[0, 0]
    assert found[255, 0] > found[255, 2]


@pytest.mark.parametrize("up", [False, True])
def test_the_first_axis_runs_across(modules, up):
    """The pixel of a voxel is where its axes say; what exceeds the window has the colour of its end."""
    values = np.arange(12.0).reshape(3, 4)
    script = """const out = new Uint32Array(12);
        m.paint({values: given.values, shape: [3, 4]}, [2, 9], m.colourTable("grey"), {up: given.up, out});
        return [...out];"""
    found = rgb(modules.call(MODULE, script, values=values.ravel(), up=up))[:, 0].reshape(4, 3)
    share = np.clip((values - 2) / 7, 0, 1).T * 255
    assert np.abs(found - (share[::-1] if up else share)).max() <= 1


def test_depths_show_height_as_brightness(modules):
    """A voxel of no height is black whatever its depth; one at the window's end has the hue of its depth."""
    script = """const out = new Uint32Array(4);
        m.paintDepths({values: [0, 1, 1, 0.5], shape: [4, 1]}, (i) => i / 3, [0, 1], {out}); return [...out];"""
    found = rgb(modules.call(MODULE, script))
    hues = depth_colours().astype(int)
    assert found[0].tolist() == [0, 0, 0]
    assert np.abs(found[1] - hues[85]).max() <= 1
    assert np.abs(found[3] - hues[255] / 2).max() <= 1


def test_the_bar_has_a_value_s_colour_below_it(modules):
    """Colours run from one handle to the other; beyond they are those of the ends, as in the picture."""
    script = """const out = new Uint32Array(200);
        m.paintRamp(m.colourTable("grey"), [-1, 3], [0, 2], out); return [...out];"""
    found = rgb(modules.call(MODULE, script))[:, 0]
    values = -1 + 4 * (np.arange(200) + 0.5) / 200
    assert np.abs(found - 255 * np.clip(values / 2, 0, 1)).max() <= 1
