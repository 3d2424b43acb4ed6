"""Pictures of masks and plans show their values where the axes say."""

from itertools import pairwise

import numpy as np
import pytest

from steradian.masks import equi_steradian_mask, equiangular_mask, grid_mask, hexagonal_mask
from steradian.masks.limited_view import limited_view
from steradian.masks.metrics import evaluate_mask
from steradian.masks.plots import draw_mask, mask_figure
from steradian.plans import ScanPlan
from steradian.plans.plots import draw_plan, plan_figure
from steradian.plans.preview import preview


def plots_of(mask, **options):
    """Axes of a mask's figure by the beginning of their titles."""
    figure = mask_figure(mask, with_point_spread=False, **options)
    return {axes.get_title().partition(":")[0].partition(",")[0]: axes for axes in figure.axes}


def value_at(axes, x, y):
    """Value of the image in axes at a place on them."""
    (image,) = axes.images
    left, right, bottom, top = image.get_extent()
    values = image.get_array()
    row = (y - bottom) / (top - bottom) * values.shape[0]
    if image.origin == "upper":
        row = values.shape[0] - row
    return values[int(row), int((x - left) / (right - left) * values.shape[1])]


def test_sensors_are_drawn_at_their_positions_in_the_colours_of_their_weights():
    mask = equi_steradian_mask(8e-3, 2e-3, 100, offset=(1e-3, -0.5e-3))
    axes = plots_of(mask)["Sensors"]
    np.testing.assert_allclose(axes.collections[0].get_offsets(), 1e3 * mask.positions)
    np.testing.assert_allclose(axes.collections[0].get_array(), 1e6 * mask.weights)
    assert axes.lines[-1].get_xydata() == pytest.approx(np.array([[1.0, -0.5]]))
    assert axes.get_aspect() == 1
    assert axes.get_xlim() == axes.get_ylim() == pytest.approx((-4.2, 4.2))


def test_spacing_is_least_where_the_sensors_are_dense():
    """The point of interest lies at positive x and negative y: there the sensors are close to each other."""
    axes = plots_of(equi_steradian_mask(8e-3, 1e-3, 200, offset=(2e-3, -1e-3)))["Spacing"]
    there = value_at(axes, 2.0, -1.0)
    assert all(value_at(axes, *place) > 1.5 * there for place in ((-2.0, -1.0), (2.0, 2.0), (-2.0, 2.0)))


def test_limited_view_shows_the_share_of_each_depth():
    mask = equi_steradian_mask(8e-3, 2e-3, 100, offset=(1e-3, 0))
    seen = limited_view(mask, 4e-3)
    axes = plots_of(mask, deepest=4e-3)["Limited view"]
    assert axes.get_ylim() == (4.0, 0.0)
    for x, z in ((-2.0, 0.5), (2.0, 0.5), (1.0, 3.5)):
        at = np.abs(seen.x - 1e-3 * x).argmin(), np.abs(seen.z - 1e-3 * z).argmin()
        assert value_at(axes, x, z) == pytest.approx(100 * seen.share[at], abs=2)


def test_the_lines_of_the_limited_view_are_where_edges_of_a_tilt_are_just_seen_from_both_sides():
    mask = equi_steradian_mask(8e-3, 2e-3, 100, offset=(1e-3, 0))
    seen = limited_view(mask, 4e-3, pixels=400)
    both = np.degrees(np.minimum(seen.steepest_left, seen.steepest_right))
    lines = [line.get_xydata() for line in plots_of(mask, deepest=4e-3)["Limited view"].lines]
    lines = [line for line in lines if len(line) == 3]
    assert len(lines) == 5
    for tilt, line in zip((15, 30, 45, 60, 75), lines, strict=True):
        for start, end in pairwise(line):
            places = 1e-3 * (start + np.linspace(0.2, 0.8, 7)[:, None] * (end - start))
            within = places[places[:, 1] < 3.9e-3]
            x, z = (np.abs(seen.x - within[:, :1]).argmin(axis=1), np.abs(seen.z - within[:, 1:]).argmin(axis=1))
            np.testing.assert_allclose(both[x, z], tilt, atol=1.5)


def test_histogram_counts_every_sensor():
    mask = equi_steradian_mask(8e-3, 2e-3, 100)
    (steps,) = plots_of(mask)["Solid angle that each sensor covers"].patches
    counts, edges, _ = steps.get_data()
    angles = 100 * evaluate_mask(mask).solid_angles / evaluate_mask(mask).solid_angles.mean()
    assert counts.sum() == mask.count
    assert edges[0] < angles.min() <= angles.max() < edges[-1]


def test_no_quarter_of_a_mask_is_empty():
    """A mask without a point of interest, or without its simulation, shows how even the sensors are."""
    for mask, simulated in ((grid_mask(13.56e-3, 41, 300e-6), True), (equiangular_mask(1e-2, 2e-3, 30), False)):
        figure = mask_figure(mask, with_point_spread=simulated)
        plots = [axes for axes in figure.axes if axes.get_title()]
        assert len(plots) == 4
        assert all(axes.has_data() for axes in plots)


@pytest.mark.long
def test_the_same_distance_everywhere_is_one_colour_with_a_number():
    """Distances of a lattice differ by their rounding, which is nothing to colour."""
    plots = plots_of(hexagonal_mask(13.56e-3, count=400))
    for shown in (plots["Sensors"].collections[0], plots["Spacing"].images[0]):
        tones = 255 * shown.to_rgba(np.ravel(shown.get_array()))[:, :3]
        assert np.ptp(tones, axis=0).max() < 3
        low, high = shown.get_clim()
        assert any(low < tick < high for tick in shown.colorbar.get_ticks())


def test_plan_shows_path_and_seconds():
    plan = ScanPlan.create(mask=equi_steradian_mask(8e-3, 2e-3, 100))
    cost = preview(plan)
    way, seconds, moves = (axes for axes in plan_figure(plan, cost).axes if axes.get_title())
    np.testing.assert_allclose([line[0] for line in way.collections[0].get_segments()], 1e3 * plan.path[:-1])
    marks = [line.get_xydata()[0] for line in way.lines]
    np.testing.assert_allclose(marks, 1e3 * plan.path[[0, -1]])
    names = [label.get_text() for label in seconds.get_yticklabels()]
    assert dict(zip(names, (bar.get_width() for bar in seconds.patches), strict=True)) == pytest.approx(cost.seconds)
    assert seconds.lines[0].get_xdata()[0] == pytest.approx(cost.total_seconds)
    assert moves.patches[0].get_data()[0].sum() == len(plan.path)
    assert moves.get_yscale() == "log"


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
