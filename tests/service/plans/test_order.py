"""Visit orders reach every point once, on a way as short as they say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from steradian import InvalidInput, ScanPlan, equi_steradian_mask, grid_mask
from steradian.masks import equiangular_mask, random_mask
from steradian.plans import VisitOrder, path_length, preview, visit_order
from steradian.plans.tour import concatenate, nearest_neighbour

SELF_CONTAINED = [order for order in VisitOrder if order not in (VisitOrder.WAVELENGTH, VisitOrder.BANDS)]


@pytest.fixture(scope="module")
def mask():
    """The paper's."""
    return equi_steradian_mask(13.56e-3, 3.6e-3, 1600)


def way(positions, order):
    return path_length(positions, visit_order(positions, order))


@settings(max_examples=25, deadline=None)
@given(
    order=st.sampled_from(SELF_CONTAINED),
    count=st.integers(1, 300),
    seed=st.integers(0, 99),
    kind=st.sampled_from(["scattered", "on a grid", "all at one place", "on a line"]),
)
def test_every_point_is_visited_once(order, count, seed, kind):
    """Any order of any points is a permutation, also where points coincide."""
    points = np.random.default_rng(seed).random((count, 2)) * 1e-2
    if kind == "on a grid":
        points = np.round(points, 3)
    if kind == "all at one place":
        points[:] = 1e-3
    if kind == "on a line":
        points[:, 1] = 0
    assert sorted(visit_order(points, order).tolist()) == list(range(count))


def test_the_shortest_way_through_the_papers_mask(mask):
    """1,605 points need at most 475 mm; slice by slice it is over 585, in rows over 500."""
    lengths = {order: 1e3 * way(mask.positions, order) for order in SELF_CONTAINED}
    assert lengths["shortest"] <= 475
    assert lengths["shortest"] < lengths["hilbert"] < lengths["given"]
    assert lengths["shortest"] < lengths["snake"] < lengths["given"]


@pytest.mark.long
@pytest.mark.parametrize("kind", ["random", "equi-steradian"])
def test_large_masks_get_orders_near_the_nearest_neighbours(kind):
    """Hilbert is within 30 % of nearest neighbour, and the improved way is shorter than both."""
    mask = random_mask(1e-2, 20_000) if kind == "random" else equi_steradian_mask(13.56e-3, 3.6e-3, 20_000)
    nearest = path_length(mask.positions, nearest_neighbour(mask.positions))
    assert way(mask.positions, "hilbert") < 1.3 * nearest
    assert way(mask.positions, "shortest") < nearest


@pytest.mark.long
@pytest.mark.parametrize("order", ["hilbert", "shortest"])
def test_200_000_points_can_be_ordered(order):
    """No n × n matrix is needed: the way through 200,000 points grows like the root of their number."""
    positions = random_mask(1.0, 200_000).positions
    visit = visit_order(positions, VisitOrder(order))
    assert np.bincount(visit).max() == 1
    assert path_length(positions, visit) < np.sqrt(200_000)


def test_no_two_edges_of_the_shortest_way_can_be_swapped_with_gain():
    """The way is 2-optimal among near neighbours."""
    positions = random_mask(1.0, 400).positions
    tour = positions[visit_order(positions, VisitOrder.SHORTEST)]
    place = KDTree(tour).query(tour, k=6)[1]
    edge = np.linalg.norm(np.diff(tour, axis=0), axis=1)
    for i in range(len(tour) - 1):
        for j in place[i, 1:]:
            if i < j < len(tour) - 1:
                swapped = np.linalg.norm(tour[i] - tour[j]) + np.linalg.norm(tour[i + 1] - tour[j + 1])
                assert swapped > edge[i] + edge[j] - 1e-9


def test_the_way_between_points_on_a_line_is_its_length():
    """A line is swept once."""
    line = equiangular_mask(1e-2, 3e-3, 100)
    plan = ScanPlan.create(mask=line, order="shortest")
    assert preview(plan).travel == pytest.approx(1e-2, rel=1e-9)


def test_concatenated_tours_begin_at_the_end_that_is_nearer():
    line = np.column_stack([np.arange(6.0), np.zeros(6)])
    pieces = [np.array(piece) for piece in ([0, 1], [3, 2], [4, 5])]
    assert concatenate(line, pieces).tolist() == [0, 1, 2, 3, 4, 5]


def test_sorting_by_wavelength_retunes_once_a_wavelength(mask):
    """Where tuning dominates, going wavelength by wavelength is quicker than the shortest way."""
    wavelengths = 1.55e-6 + np.random.default_rng(0).integers(0, 8, mask.count) * 50e-12
    sorted_, shortest = (
        preview(ScanPlan.create(mask=mask, order=order, wavelengths=wavelengths, pulse_rate=400))
        for order in ("wavelength", "shortest")
    )
    assert sorted_.retunings == 7
    assert shortest.retunings > 1000
    assert shortest.limiting == "tuning"
    assert sorted_.travel > shortest.travel
    assert sorted_.total_seconds < 0.5 * shortest.total_seconds


def test_an_order_by_wavelength_needs_wavelengths(mask):
    """It is refused without them, and wavelengths must fit the points."""
    with pytest.raises(InvalidInput, match="wavelengths"):
        ScanPlan.create(mask=mask, order="wavelength")
    with pytest.raises(InvalidInput, match="wavelengths"):
        visit_order(mask.positions, VisitOrder.WAVELENGTH)
    with pytest.raises(InvalidInput, match=r"\(1605,\)"):
        ScanPlan.create(mask=mask, wavelengths=[1.55e-6])


def test_orders_are_the_same_every_time():
    """No order depends on chance or on the clock."""
    for order in SELF_CONTAINED:
        first, again = (ScanPlan.create(mask=grid_mask(1e-2, 12, 5e-4), order=order) for _ in range(2))
        np.testing.assert_array_equal(first.visit, again.visit)
        assert first.id == again.id
