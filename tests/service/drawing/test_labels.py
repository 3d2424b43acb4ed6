"""No label of any picture is cut or meets another, whatever the picture's size."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from matplotlib.text import Text

from steradian.comparisons import compare_masks, phantom
from steradian.comparisons.plots import comparison_figure
from steradian.imaging import Display, Volume, VoxelAxes
from steradian.masks import equi_steradian_mask, equiangular_mask, grid_mask, mask_by_count
from steradian.masks.plots import mask_figure
from steradian.plans import ScanPlan, VisitOrder
from steradian.plans.plots import plan_figure
from steradian.reconstructions.volumes.images import draw_depth_coded, draw_mip

SIZES = (240, 720, 1500)
WIDTHS = (640, 1320, 2200)
MASKS = {
    "equi-steradian": equi_steradian_mask(13.56e-3, 3.6e-3, 300),
    "off the centre": equi_steradian_mask(13.56e-3, 3.6e-3, 200, offset=(3e-3, -2e-3)),
    "grid": grid_mask(13.56e-3, 41, 300e-6),
    "line": equiangular_mask(10e-3, 2e-3, 30),
}


def overlapping(boxes, size):
    """Labels that meet another, or leave the picture."""
    apart = [
        (a, b)
        for (a, (left, top, right, bottom)), (b, other) in combinations(boxes, 2)
        if left < other[2] and other[0] < right and top < other[3] and other[1] < bottom
    ]
    cut = [text for text, box in boxes if min(box) < 0 or box[2] > size[0] or box[3] > size[1]]
    return apart + cut


def labels_of(figure):
    """Text and window extent of every label that is drawn; ticks beyond the view have labels too, which are not."""
    figure.canvas.draw()
    hidden = set()
    for axes in figure.findobj(lambda artist: hasattr(artist, "get_xaxis") and hasattr(artist, "get_yaxis")):
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            slack = 1e-6 * (high - low)
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
                if not low - slack <= tick.get_loc() <= high + slack or not axes.axison:
                    hidden |= {tick.label1, tick.label2}
    texts = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    return [(text.get_text(), text.get_window_extent().extents) for text in texts if text not in hidden]


def volume(*shape):
    values = np.random.default_rng(0).normal(size=shape).astype(np.float32) ** 2
    x, z = 1e-4 * (np.arange(shape[0]) - shape[0] // 2), 1e-3 + 5e-5 * np.arange(shape[-1])
    y = 1e-4 * (np.arange(shape[1]) - shape[1] // 2) if len(shape) == 3 else None
    return Volume(values, VoxelAxes(x, y, z), (*[1e-4] * (len(shape) - 1), 5e-5))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("shape", [(90, 70, 60), (200, 3, 5), (3, 200, 4), (2, 2, 400), (6, 300), (300, 4)])
@pytest.mark.parametrize("log_range", [None, 40.0])
def test_labels_of_projections(tmp_path, size, shape, log_range):
    display = Display(size=size, log_range_db=log_range)
    image = display.apply(volume(*shape))
    pictures = [draw_mip(image, axis, tmp_path / "a.png", display) for axis in ("xyz" if len(shape) == 3 else "y")]
    if len(shape) == 3:
        pictures.append(draw_depth_coded(image, tmp_path / "a.png", display))
    for drawn in pictures:
        assert len(drawn.labels) > 4
        assert not overlapping(drawn.labels, drawn.size)
        left, top, right, bottom = drawn.frame
        assert max(right - left, bottom - top) == size


def check_labels(figure, width):
    labels = labels_of(figure)
    assert len(labels) > 20
    assert not overlapping(labels, figure.canvas.get_width_height())
    assert figure.canvas.get_width_height()[0] == width


@pytest.mark.long
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", MASKS)
@pytest.mark.parametrize("with_point_spread", [True, False])
def test_labels_of_masks(width, name, with_point_spread):
    check_labels(mask_figure(MASKS[name], with_point_spread=with_point_spread, width=width), width)


@pytest.mark.long
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", ["equi-steradian", "line"])
@pytest.mark.parametrize("order", [VisitOrder.SNAKE, VisitOrder.PROGRESSIVE])
def test_labels_of_plans(width, name, order):
    check_labels(plan_figure(ScanPlan.create(mask=MASKS[name], order=order), width=width), width)


def test_labels_of_a_mask_and_its_plan():
    check_labels(mask_figure(MASKS["off the centre"], with_point_spread=False, width=640), 640)
    check_labels(plan_figure(ScanPlan.create(mask=MASKS["off the centre"]), width=640), 640)


@pytest.fixture(scope="module")
def comparison():
    names = ("equi-steradian", "grid", "poisson-disc", "random")
    masks = {name: mask_by_count(name, 4e-3, 120, depth=1e-3) for name in names}
    return compare_masks(masks, phantom=phantom("vessels", (0.0, 0.0, 1e-3)), modes=40, iterations=1)


@pytest.mark.long
@pytest.mark.parametrize(("width", "simulated"), [(700, True), (1320, False), (2600, True)])
def test_labels_of_comparisons(width, simulated, comparison):
    compared = comparison if simulated else replace(comparison, simulation=None, simulated={})
    figure = comparison_figure(compared, width=width)
    assert not overlapping(labels_of(figure), figure.canvas.get_width_height())


def test_titles_describe_and_hold_no_identifier():
    mask = MASKS["equi-steradian"]
    plan = ScanPlan.create(mask=mask)
    title = mask_figure(mask, with_point_spread=False).get_suptitle()
    assert "Equi-steradian" in title
    assert "3.6 mm deep" in title
    for words in (title, plan_figure(plan).get_suptitle()):
        assert f"{mask.count:,} points" in words
        assert mask.id not in words
        assert plan.id not in words
