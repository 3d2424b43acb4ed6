"""A wanted number of points gives the nearest one that an arrangement can have."""

from typing import get_args

import numpy as np
import pytest

from steradian import InvalidInput, equi_steradian_mask, hexagonal_mask
from steradian.masks import (
    Counted,
    convenient_counts,
    grid_mask,
    hexagonal_interval,
    mask_by_count,
    nearest_square,
    poisson_disc_mask,
    with_point_of_interest,
)
from steradian.masks.cap_slices import slice_cap

APERTURE, DEPTH = 13.56e-3, 3.6e-3
RIM = float(np.arctan(APERTURE / 2 / DEPTH))


@pytest.mark.parametrize("count", [60, 333, 1000, 1625, 2000])
def test_equi_steradian_mask_uses_nearest_feasible_count(count):
    """By brute force: of all numbers around, those that slicing uses up exactly."""
    around = range(max(5, count - 200), count + 200)
    possible = [number for number in around if slice_cap(RIM, number).total == number]
    nearest = min(possible, key=lambda number: (abs(number - count), -number))
    assert equi_steradian_mask(APERTURE, DEPTH, count).count == nearest
    below, above = convenient_counts(APERTURE, DEPTH, count)
    assert below == max(number for number in possible if number < count)
    assert above == min(number for number in possible if number >= count)


@pytest.mark.parametrize("count", [200, 555])
def test_off_the_centre_the_nearer_of_both_is_taken(count):
    offset = (3e-3, -1e-3)
    below, above = convenient_counts(APERTURE, DEPTH, count, offset)
    assert below < count <= above
    found = equi_steradian_mask(APERTURE, DEPTH, count, offset=offset).count
    assert found == (below if count - below < above - count else above)


@pytest.mark.parametrize(
    "count", [1, 2, 30, 381, *(pytest.param(count, marks=pytest.mark.long) for count in (5, 100, 900, 2000))]
)
def test_a_hexagonal_lattice_has_the_nearest_number_of_all_intervals(count):
    """By brute force over 4,000 intervals, the lattices themselves counted."""
    guess = APERTURE * (2 / 3**0.5 / count) ** 0.5
    tried = {hexagonal_mask(APERTURE, interval).count for interval in np.geomspace(0.6, 1.8, 800) * guess}
    tried |= {hexagonal_mask(APERTURE, 2 * APERTURE).count}
    nearest = min(tried, key=lambda number: (abs(number - count), -number))
    assert hexagonal_mask(APERTURE, hexagonal_interval(APERTURE, count)).count == nearest


@pytest.mark.parametrize("count", range(1, 200, 7))
def test_a_grid_has_the_nearest_square(count):
    assert nearest_square(count) ** 2 == min((n**2 for n in range(1, 30)), key=lambda n: (abs(n - count), -n))


@pytest.mark.parametrize("count", [50, 700, 2000])
@pytest.mark.parametrize("seed", [0, 3])
def test_poisson_disc_points_come_within_half_a_percent(count, seed):
    """And keep their distance: the spacing found is the least distance."""
    mask = mask_by_count("poisson-disc", APERTURE, count, seed=seed)
    assert abs(mask.count - count) <= max(1, 0.005 * count)
    again = poisson_disc_mask(APERTURE, mask.arrangement["spacing"], seed=seed)
    np.testing.assert_array_equal(mask.positions, again.positions)


@pytest.mark.parametrize("name", get_args(Counted))
def test_every_arrangement_takes_a_count_and_a_depth(name):
    mask = mask_by_count(name, APERTURE, 400, depth=DEPTH, offset=(1e-3, 0.0))
    assert abs(mask.count - 400) < 30
    np.testing.assert_array_equal(mask.points_of_interest, [[1e-3, 0.0, DEPTH]])
    assert mask.arrangement["arrangement"] == name


def test_a_point_of_interest_changes_no_point():
    grid = grid_mask(APERTURE, 9, 1e-3)
    seen = with_point_of_interest(grid, DEPTH)
    np.testing.assert_array_equal(seen.positions, grid.positions)
    assert seen.id != grid.id
    with pytest.raises(InvalidInput, match="offset"):
        with_point_of_interest(grid, DEPTH, (1.0, 0.0))


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"arrangement": "spiral"}, "arrangement"),
        ({"count": 0}, "count"),
        ({"arrangement": "equi-steradian"}, "depth"),
    ],
)
def test_nonsense_is_refused(wrong, field):
    with pytest.raises(InvalidInput) as refused:
        mask_by_count(**{"arrangement": "grid", "aperture": APERTURE, "count": 10} | wrong)
    assert refused.value.field == field
