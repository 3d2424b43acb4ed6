"""Equi-steradian masks keep the paper's promises."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree, SphericalVoronoi

from steradian import InvalidInput, equi_steradian_mask
from steradian.masks import ScannerGrid, convenient_counts

APERTURE, DEPTH = 13.56e-3, 3.6e-3


def solid_angles(mask):
    """Spherical Voronoi cells around the point of interest, and whether they stay within aperture and cap."""
    focus, half = np.array(mask.offset), mask.aperture / 2
    rays = np.column_stack([mask.positions - focus, np.full(mask.count, mask.depth)])
    diagram = SphericalVoronoi(rays / np.linalg.norm(rays, axis=1)[:, None])
    diagram.sort_vertices_of_regions()
    with np.errstate(divide="ignore", invalid="ignore"):
        corners = diagram.vertices[:, :2] / diagram.vertices[:, 2:] * mask.depth
    seen = (diagram.vertices[:, 2] > 1e-9) & (np.abs(corners + focus).max(axis=1) <= half)
    seen &= np.hypot(*corners.T) <= half + np.abs(focus).max()
    return diagram.calculate_areas(), np.array([seen[region].all() for region in diagram.regions])


def test_the_papers_mask_has_the_papers_count_and_weight_ratio():
    """Asking 1,600 points gives 1,605; the outermost weighs about 9.7 times the innermost (paper, section 5)."""
    mask = equi_steradian_mask(APERTURE, DEPTH, 1600, weighting="analytic")
    assert mask.count == 1605
    assert mask.arrangement["slices"] == [1, 4, 8, 8] + 3 * [16] + 8 * [32] + 20 * [64]
    assert mask.weight_ratio == pytest.approx(9.7, abs=0.5)


def _common_area(radius, centre, aperture):
    """Area of a disc within the aperture, from the length of each of many columns."""
    x = (np.arange(20_000) + 0.5) / 20_000 * aperture - aperture / 2
    reach = np.sqrt(np.maximum(radius**2 - (x - centre[0]) ** 2, 0))
    high, low = np.minimum(centre[1] + reach, aperture / 2), np.maximum(centre[1] - reach, -aperture / 2)
    return np.maximum(high - low, 0).mean() * aperture


@pytest.mark.long
@settings(max_examples=12, deadline=None)
@given(
    aperture=st.floats(1e-3, 0.2),
    relative_depth=st.floats(0.06, 3),
    count=st.integers(50, 1500),
    offset=st.tuples(st.floats(-0.45, 0.45), st.floats(-0.45, 0.45)) | st.just((0.0, 0.0)),
)
def test_every_point_covers_the_same_solid_angle(aperture, relative_depth, count, offset):
    """Cells that the rim does not cut vary by less than 6 %, slices hold powers of two, weights sum to the disc."""
    place = (offset[0] * aperture, offset[1] * aperture)
    mask = equi_steradian_mask(aperture, relative_depth * aperture, count, offset=place)
    assert mask.count in convenient_counts(aperture, relative_depth * aperture, count, place)
    areas, whole = solid_angles(mask)
    assert whole.sum() > 3
    assert areas[whole].std() / areas[whole].mean() < 0.06
    assert all(number & (number - 1) == 0 for number in mask.arrangement["slices"])
    radius = aperture * (0.5 + max(map(abs, offset)))
    assert mask.sensed_area == pytest.approx(_common_area(radius, place, aperture), rel=3e-4)
    closest = KDTree(mask.positions).query(mask.positions, k=2)[0][:, 1].min()
    assert closest > 0.5 * np.sqrt(areas[whole].mean()) * mask.depth


@pytest.mark.parametrize("count", [60, 400, 1600, 6000])
def test_the_solid_angle_is_the_caps_share(count):
    """Each point covers the cap's solid angle over the number of points; those at the rim a part of it."""
    mask = equi_steradian_mask(APERTURE, DEPTH, count)
    areas, whole = solid_angles(mask)
    cap = 2 * np.pi * (1 - DEPTH / np.hypot(DEPTH, APERTURE / 2))
    assert areas[whole].mean() == pytest.approx(cap / (mask.count - mask.arrangement["slices"][-1] / 4), rel=0.03)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (3e-3, -1e-3)])
def test_the_papers_weights_sum_to_the_sensed_area(offset):
    """Σh is the disc within the aperture and h ∝ r³, r from the point of interest (paper, section 4.2)."""
    mask = equi_steradian_mask(APERTURE, DEPTH, 300, offset=offset, weighting="analytic")
    cells = equi_steradian_mask(APERTURE, DEPTH, 300, offset=offset)
    assert mask.sensed_area == pytest.approx(cells.sensed_area, rel=1e-12)
    distance = np.hypot(np.linalg.norm(mask.positions - offset, axis=1), DEPTH)
    assert np.ptp(mask.weights / distance**3) < 1e-9 * (mask.weights / distance**3).max()


def test_the_outermost_points_lie_close_to_the_rim():
    """A mask uses its whole opening angle, and no point lies beyond the inscribed disc."""
    radius = np.linalg.norm(equi_steradian_mask(APERTURE, DEPTH, 1600).positions, axis=1)
    assert 0.98 * APERTURE / 2 < radius.max() < APERTURE / 2


def test_a_point_of_interest_at_the_side_draws_the_points_there():
    """Away from the centre the mask is densest below the point of interest and still reaches the far edge."""
    mask = equi_steradian_mask(APERTURE, DEPTH, 800, offset=(4e-3, 0.0))
    spacing, nearest = KDTree(mask.positions).query(mask.positions, k=2)[0][:, 1], mask.positions[0]
    np.testing.assert_allclose(nearest, (4e-3, 0.0), atol=1e-12)
    assert spacing[:20].mean() < 0.3 * spacing[-20:].mean()
    assert mask.positions[:, 0].min() < -0.45 * APERTURE
    assert np.abs(mask.positions).max() <= APERTURE / 2


def test_a_mask_snapped_to_a_scanners_grid_lies_on_it_without_twins():
    """Points are moved by at most half an interval; those that meet are merged and keep the total weight."""
    grid = ScannerGrid(count=226, interval=60e-6)
    mask = equi_steradian_mask(APERTURE, DEPTH, 1600, grid=grid)
    steps = mask.positions / 60e-6
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
    assert steps.min() >= -113
    assert steps.max() <= 112
    dense = equi_steradian_mask(APERTURE, DEPTH, 20_000, grid=grid)
    assert len(np.unique(dense.positions, axis=0)) == dense.count < 20_000
    assert mask.sensed_area == pytest.approx(np.pi / 4 * APERTURE**2, rel=2e-3)
    assert dense.sensed_area == pytest.approx(np.pi / 4 * APERTURE**2, rel=2e-3)


def test_neighbouring_convenient_counts_are_offered():
    """1,625 is not reachable; 1,605 and 1,669 are the counts beside it. A convenient count is its own next."""
    assert convenient_counts(APERTURE, DEPTH, 1625) == (1605, 1669)
    assert convenient_counts(APERTURE, DEPTH, 1605)[1] == 1605
    below, above = convenient_counts(APERTURE, DEPTH, 500, offset=(2e-3, 2e-3))
    assert below < 500 <= above
    assert equi_steradian_mask(APERTURE, DEPTH, below, offset=(2e-3, 2e-3)).count == below


def test_same_parameters_same_identifier():
    """A mask is identified by its content."""
    assert equi_steradian_mask(APERTURE, DEPTH, 300).id == equi_steradian_mask(APERTURE, DEPTH, 300).id
    assert equi_steradian_mask(APERTURE, DEPTH, 300).id != equi_steradian_mask(APERTURE, DEPTH, 200).id


@pytest.mark.parametrize("count", [50, pytest.param(200_000, marks=pytest.mark.long)])
def test_small_and_large_masks_can_be_made(count):
    """From 50 to 200,000 points the count asked is met within one slice."""
    mask = equi_steradian_mask(APERTURE, DEPTH, count)
    assert count <= mask.count <= count + mask.arrangement["slices"][-1]


@pytest.mark.parametrize(
    ("parameters", "field", "allowed"),
    [
        ({"depth": -1e-3}, "depth", "> 0"),
        ({"depth": float("nan")}, "depth", "> 0"),
        ({"aperture": 0}, "aperture", "> 0"),
        ({"count": 2}, "count", "at least 5"),
        ({"offset": (8e-3, 0)}, "offset", "±0.00678"),
        ({"offset": (float("inf"), 0)}, "offset.0", "finite"),
        ({"weighting": "heavy"}, "weighting", "'voronoi'"),
    ],
)
def test_bad_parameters_name_field_value_and_range(parameters, field, allowed):
    """A wrong parameter is refused with its name and what is allowed."""
    with pytest.raises(InvalidInput) as refused:
        equi_steradian_mask(**({"aperture": APERTURE, "depth": DEPTH, "count": 300} | parameters))
    assert refused.value.field == field
    assert allowed in refused.value.allowed
