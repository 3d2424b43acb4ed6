"""Some of a mask's points make a mask."""

import numpy as np
import pytest

from steradian import InvalidInput, equi_steradian_mask, grid_mask
from steradian.masks import equiangular_mask, nearest_points, subset_mask


def test_a_sparse_mask_on_the_points_of_a_dense_scan():
    """The paper's own experiment: of 226 × 226 points those nearest to an equi-steradian mask, each once."""
    dense = grid_mask(13.56e-3, 226, 60e-6)
    wanted = equi_steradian_mask(13.56e-3, 3.6e-3, 1600)
    numbers = nearest_points(dense, wanted)
    mask = subset_mask(dense, numbers)
    assert mask.count == len(set(numbers)) == 1605
    assert np.abs(mask.positions - wanted.positions).max() <= 61e-6  # the grid ends an interval before the rim
    assert mask.sensed_area == pytest.approx(wanted.sensed_area, rel=0.03)
    assert mask.arrangement["of"] == dense.id


def test_points_keep_their_own_weights_if_asked():
    """Analytic weights are the whole mask's, scaled."""
    mask = equi_steradian_mask(1e-2, 3e-3, 100)
    half = subset_mask(mask, range(0, mask.count, 2), weighting="analytic")
    np.testing.assert_allclose(half.weights / half.weights[0], mask.weights[::2] / mask.weights[0])
    assert half.depth == mask.depth


@pytest.mark.parametrize(
    ("indices", "field"), [([0, 999], r"indices[1]"), ([-1], r"indices[0]"), ([3, 3], "indices"), ([], "indices")]
)
def test_wrong_numbers_are_named(indices, field):
    """Numbers out of range or twice are refused."""
    with pytest.raises(InvalidInput) as refused:
        subset_mask(grid_mask(1e-2, 5, 1e-3), indices)
    assert refused.value.field == field


def test_a_line_is_no_part_of_a_plane():
    """Lines and planes are not mixed."""
    with pytest.raises(InvalidInput, match="same kind"):
        nearest_points(grid_mask(1e-2, 5, 1e-3), equiangular_mask(1e-2, 1e-3, 9))
