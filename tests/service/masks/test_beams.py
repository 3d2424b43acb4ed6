"""A mask as a pattern of beams measures it: rigid, within what is sensed, as dense as the mask, by few places."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from steradian import InvalidInput, equi_steradian_mask, equiangular_mask, grid_mask
from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.voronoi import voronoi_cell_areas
from steradian.masks import multi_beam_mask
from steradian.masks.multi_beam import read_beams

SQUARE = read_beams("4x4", 0.5e-3)


@pytest.fixture(scope="module")
def mask():
    return equi_steradian_mask(13.56e-3, 3.6e-3, 400)


@pytest.fixture(scope="module")
def covered(mask):
    return multi_beam_mask(mask, SQUARE)


@pytest.fixture(scope="module")
def paper():
    """The mask of the paper's yarn, and what the pattern measures in its place."""
    mask = equi_steradian_mask(13.56e-3, 3.6e-3, 1600)
    return mask, multi_beam_mask(mask, SQUARE)


@pytest.mark.long
def test_points_are_the_pattern_moved_as_a_whole_and_as_few_places_as_there_can_be(mask, covered):
    assert covered.arrangement["places"] == -(-mask.count // 16)
    shots = covered.positions.reshape(-1, 16, 2)
    np.testing.assert_allclose(shots - shots[:, :1], np.broadcast_to(SQUARE, shots.shape), rtol=0, atol=1e-15)
    np.testing.assert_allclose(shots[:, 0] * 1e9, np.rint(shots[:, 0] * 1e9), atol=1e-6)


@pytest.mark.long
def test_multi_beam_points_stay_in_outline_and_cover_sensed_area(mask, covered):
    assert outlines.contains(outlines.buffered_hull(mask.outline, 1e-9), covered.positions).all()
    np.testing.assert_allclose(covered.weights, voronoi_cell_areas(covered.positions, mask.outline), rtol=1e-9)
    assert covered.sensed_area == pytest.approx(mask.sensed_area, rel=1e-12)
    assert (covered.depth, covered.aperture) == (mask.depth, mask.aperture)


@pytest.mark.long
def test_the_density_is_the_masks(paper):
    """As many points, within a tenth, where the mask has its densest third of points, its middle and its sparsest."""
    mask, covered = paper
    cells = voronoi_cell_areas(mask.positions, mask.outline)
    third = np.digitize(cells, np.quantile(cells, [1 / 3, 2 / 3]))
    assert cells[third == 2].mean() > 4 * cells[third == 0].mean()
    found = np.bincount(third[KDTree(mask.positions).query(covered.positions)[1]])
    np.testing.assert_allclose(found, np.bincount(third) * covered.count / mask.count, rtol=0.1)


@pytest.mark.long
def test_the_cover_is_nearly_as_even_as_the_mask_and_far_evener_than_places_drawn_by_chance(paper):
    """The quantisation error at points of the plane, by a direct sum: the mask's own is the measure."""
    mask, covered = paper
    plane = np.random.default_rng(3).uniform(-6.7e-3, 6.7e-3, (40_000, 2))
    plane = plane[np.hypot(*plane.T) < 6.7e-3]
    wanted = voronoi_cell_areas(mask.positions, mask.outline)[KDTree(mask.positions).query(plane)[1]] ** -2
    drawn = mask.positions[
        np.random.default_rng(4).choice(mask.count, len(covered.positions) // 16, replace=False)
    ] - np.mean(SQUARE, axis=0)
    chance = (drawn[:, None] + SQUARE).reshape(-1, 2)
    own, ours, by_chance = (
        float((wanted * KDTree(each).query(plane)[0] ** 2).sum())
        for each in (mask.positions, covered.positions, chance)
    )
    assert ours < 1.25 * own
    assert by_chance > 2 * own


def test_multi_beam_arrangement_reports_request_and_displacement(mask, covered):
    off = KDTree(covered.positions).query(mask.positions)[0]
    told = covered.arrangement
    assert told["displacement"] == pytest.approx({"median": np.median(off), "largest": off.max()})
    assert (told["of"], told["asked"]) == (mask.id, mask.count)
    np.testing.assert_array_equal(told["beams"], SQUARE)


@pytest.mark.long
def test_one_beam_is_any_mask_of_as_many_points_and_the_same_call_gives_the_same_mask():
    small = grid_mask(1e-2, 6, 1e-3)
    alone = multi_beam_mask(small, [(0, 0)])
    assert alone.count == 36
    assert alone.id == multi_beam_mask(small, [(0, 0)]).id


@pytest.mark.parametrize(
    ("beams", "field"),
    [
        ([(1e-3, 0), (0, 0)], r"beams\[0\]"),
        ([(0, 0), (0, 0)], "two at the same place"),
        ([(0, 0)] * 65, "beams"),
        (np.zeros((0, 2)), "beams"),
        pytest.param([(0, 0), (9e-3, 9e-3)], "fits", marks=pytest.mark.long),
        ([(0, 0), (np.nan, 0)], "beams"),
    ],
)
def test_a_pattern_that_is_none_or_does_not_fit_is_refused(beams, field):
    with pytest.raises(InvalidInput, match=field):
        multi_beam_mask(equi_steradian_mask(10e-3, 3e-3, 60), beams)


@pytest.mark.parametrize("centred", [pytest.param(True, marks=pytest.mark.long), False])
def test_beams_on_a_small_grid_stay_in_the_aperture_though_its_cells_reach_beyond(centred):
    """Cells of a grid that begins at the aperture's edge, as grids of a scanner's own interval do, are half outside."""
    small = grid_mask(8e-3, 4, 2e-3, centred=centred)
    made = multi_beam_mask(small, [(0, 0), (2e-3, 0)])
    assert made.count == 16
    assert np.abs(made.positions).max() <= 4e-3
    assert outlines.contains(outlines.buffered_hull(small.outline, 1e-9), made.positions).all()


@pytest.mark.long
def test_beam_pattern_wider_than_mask_is_refused_with_limits():
    with pytest.raises(InvalidInput, match=r"beams is a pattern of 8 mm × 0 mm.* whose extent is 7 mm × 7 mm"):
        multi_beam_mask(grid_mask(8e-3, 4, 2e-3), [(0, 0), (8e-3, 0)])


def test_a_line_and_more_places_than_points_are_refused(mask):
    with pytest.raises(InvalidInput, match="plane"):
        multi_beam_mask(equiangular_mask(1e-2, 3e-3, 32), SQUARE)
    with pytest.raises(InvalidInput, match="places"):
        multi_beam_mask(mask, SQUARE, places=mask.count + 1)


def test_patterns_are_read_from_words_and_from_a_table(tmp_path):
    assert read_beams("3", 1e-3) == ((0, 0), (1e-3, 0), (2e-3, 0))
    assert read_beams("2x2", 1e-3) == ((0, 0), (1e-3, 0), (0, 1e-3), (1e-3, 1e-3))
    table = tmp_path / "beams.csv"
    table.write_text("x_mm,y_mm\n1.5,2\n1.75,2\n1.5,2.5\n")
    np.testing.assert_allclose(read_beams(str(table), 0), [(0, 0), (0.25e-3, 0), (0, 0.5e-3)], atol=1e-12)
    for wrong in ("0", "65", "9x9", "many", "4x"):
        with pytest.raises(InvalidInput, match="beams"):
            read_beams(wrong, 1e-3)
