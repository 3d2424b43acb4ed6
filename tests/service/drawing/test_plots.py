"""What a plot shows stands where its axes say, whoever draws it."""

from itertools import pairwise

import numpy as np
import pytest

from steradian.drawing.mpl_renderer import to_figure
from steradian.drawing.plot_spec import (
    Bars,
    ColouredPath,
    Colours,
    Curve,
    Heatmap,
    Histogram,
    Marker,
    Page,
    Plot,
    Scatter,
    VerticalLine,
    histogram,
)
from steradian.drawing.raster_renderer import render_page
from steradian.drawing.ticks import Axis, LogAxis, NamedRows
from steradian.masks import equi_steradian_mask, equiangular_mask
from steradian.masks.limited_view import limited_view
from steradian.masks.plots import draw_mask, mask_figure
from steradian.plans import ScanPlan
from steradian.plans.plots import draw_plan, plan_figure

RED = (255, 0, 0)


def drawn(*parts, across=None, up=None, equal=False):
    """The pixels of a page with one plot, and the middle of each of its labels."""
    axes = across or Axis(-3.0, 5.0, "x"), up or Axis(40.0, 10.0, "y")
    painted = render_page(Page("page", [[Plot("plot", *axes, parts, equal)]], [1], 1100, 0.7))
    middles = {}
    for text, (left, top, right, bottom) in painted.labels:  # axes before bars of colours
        middles.setdefault(text, ((left + right) / 2, (top + bottom) / 2))
    return np.asarray(painted.image).astype(int), middles


def middle_of(pixels, colour=RED):
    """The middle of what has a colour."""
    rows, columns = np.nonzero((pixels == colour).all(axis=-1))
    return columns.mean(), rows.mean()


def test_marker_is_drawn_at_its_axis_coordinates():
    pixels, middles = drawn(Marker(3.0, 25.0, "o", 12, "#ff0000"))
    assert middle_of(pixels) == pytest.approx((middles["3"][0], middles["25"][1]), abs=2)


def test_a_logarithmic_axis_has_equal_steps_for_powers_of_ten():
    pixels, middles = drawn(
        Marker(30.0, 10.0, "s", 9, "#ff0000"), across=Axis(20, 40, "x"), up=LogAxis(2000.0, 0.7, "points")
    )
    assert middle_of(pixels)[1] == pytest.approx(middles["10"][1], abs=2)
    assert middles["1"][1] - middles["10"][1] == pytest.approx(middles["100"][1] - middles["1000"][1], abs=2)


def test_a_fields_first_row_is_at_the_top_and_its_first_column_on_the_left():
    values = np.zeros((4, 8))
    values[1, 6] = 1.0  # of four rows the second, of eight columns the seventh
    pixels, middles = drawn(Heatmap(values, Colours("gray", 0.0, 1.0, "")))
    left, right, top, bottom = middles["−3"][0], middles["5"][0], middles["40"][1], middles["10"][1]
    inside = pixels[round(top) + 3 : round(bottom) - 3, round(left) + 3 : round(right) - 3]
    x, y = middle_of(inside, (255, 255, 255))
    assert x + 3 == pytest.approx(6.5 / 8 * (right - left), abs=3)
    assert y + 3 == pytest.approx(1.5 / 4 * (bottom - top), abs=3)


def test_dots_ways_and_curves_go_through_their_places_in_the_colours_of_their_values():
    places = np.array([[0.0, 15.0], [2.0, 35.0]])
    reds = Colours("gray", 0.0, 1.0, "value")
    black = (0, 0, 0)
    for part in (
        Scatter(places, np.array([0.0, 0.0]), reds, 14),
        ColouredPath(places, np.array([0.0]), reds, 5),
        Curve(places, "#000000", 5),
    ):
        pixels, middles = drawn(part)
        left, right, top, bottom = middles["−3"][0], middles["5"][0], middles["40"][1], middles["10"][1]
        inside = pixels[round(top) + 3 : round(bottom) - 3, round(left) + 3 : round(right) - 3]
        x, y = middle_of(inside, black)
        assert (x + 3 + left, y + 3 + top) == pytest.approx(
            ((middles["0"][0] + middles["2"][0]) / 2, middles["25"][1]), abs=3
        )


def test_both_scales_are_one_where_that_is_asked_for():
    _, middles = drawn(across=Axis(0.0, 10.0, "x"), up=Axis(24.0, 20.0, "y"), equal=True)
    steps = middles["10"][0] - middles["2"][0], middles["20"][1] - middles["24"][1]
    assert steps[0] / 8 == pytest.approx(steps[1] / 4, rel=0.02)


def test_histogram_bars_match_bin_counts():
    steps = histogram(np.array([11.0, 11.0, 12.0, 15.0]), 4, 0.5)
    assert (steps.counts.tolist(), steps.edges.tolist()) == ([2, 1, 0, 1], [10.5, 11.75, 13.0, 14.25, 15.5])
    pixels, middles = drawn(
        Histogram(steps.edges, steps.counts, "#ff0000"), across=Axis(10, 16, "x"), up=Axis(4, 0, "n")
    )
    rows = np.nonzero((pixels == RED).all(axis=-1))[0]
    assert rows.min() == pytest.approx(middles["2"][1], abs=3)


def test_bars_of_rows_end_at_their_values_with_their_texts():
    bars = Bars([2.0, 4.0], ["two", "four"], ["#ff0000", "#00ff00"])
    pixels, middles = drawn(bars, VerticalLine(3.0), across=Axis(0, 6, "s"), up=NamedRows(("a", "b")))
    for name, text, value, colour in (("a", "two", "2", RED), ("b", "four", "4", (0, 255, 0))):
        columns = np.nonzero((pixels == colour).all(axis=-1))[1]
        assert columns.max() == pytest.approx(middles[value][0], abs=3)
        assert middle_of(pixels, colour)[1] == pytest.approx(middles[name][1], abs=3)
        assert middles[text][0] > columns.max()
        assert middles[text][1] == pytest.approx(middles[name][1], abs=4)


def test_the_lines_of_the_limited_view_are_where_edges_of_a_tilt_are_just_seen_from_both_sides():
    mask = equi_steradian_mask(8e-3, 2e-3, 100, offset=(1e-3, 0))
    seen = limited_view(mask, 4e-3, pixels=400)
    both = np.degrees(np.minimum(seen.steepest_left, seen.steepest_right))
    plot = mask_figure(mask, deepest=4e-3, with_point_spread=False).plots[1]
    lines = [part.places for part in plot.parts if isinstance(part, Curve)]
    assert len(lines) == 5
    for tilt, line in zip((15, 30, 45, 60, 75), lines, strict=True):
        for start, end in pairwise(line):
            places = 1e-3 * (start + np.linspace(0.2, 0.8, 7)[:, None] * (end - start))
            within = places[places[:, 1] < 3.9e-3]
            x, z = (np.abs(seen.x - within[:, :1]).argmin(axis=1), np.abs(seen.z - within[:, 1:]).argmin(axis=1))
            np.testing.assert_allclose(both[x, z], tilt, atol=1.5)


@pytest.mark.parametrize("mask", [equi_steradian_mask(8e-3, 2e-3, 100), equiangular_mask(1e-2, 2e-3, 30)])
def test_matplotlib_draws_the_same_pages(mask):
    """For formats that are enlarged without loss: the same titles, names and limits, and something in each plot."""
    for page in (mask_figure(mask, with_point_spread=False), plan_figure(ScanPlan.create(mask=mask))):
        figure = to_figure(page)
        assert figure.get_suptitle() == page.title
        for plot, axes in zip(page.plots, figure.axes, strict=True):
            assert (axes.get_title(), axes.get_xlabel(), axes.get_ylabel()) == (
                plot.title,
                plot.across.name,
                plot.up.name,
            )
            assert axes.get_xlim() == pytest.approx((plot.across.first, plot.across.last))
            assert axes.has_data()
            assert bool(axes.child_axes) is (plot.colours is not None)


@pytest.mark.long
@pytest.mark.parametrize(
    ("ending", "first"), [(".svg", b"<?xml"), (".pdf", b"%PDF-"), (".png", b"\x89PNG"), ("", b"\x89PNG")]
)
def test_the_ending_decides_the_format(tmp_path, ending, first):
    mask = equi_steradian_mask(8e-3, 2e-3, 40)
    draw_mask(mask, tmp_path / f"mask{ending}", with_point_spread=False)
    draw_plan(ScanPlan.create(mask=mask), tmp_path / f"plan{ending}")
    for path in tmp_path.iterdir():
        assert path.read_bytes().startswith(first)
    assert len(list(tmp_path.iterdir())) == 2
