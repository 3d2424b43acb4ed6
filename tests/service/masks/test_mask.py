"""Masks are checked, immutable values."""

import doctest

import numpy as np
import pytest

from steradian import InvalidInput, Mask, custom_mask, grid_mask


def test_grid_positions_and_weights():
    """An odd grid is symmetric, an even one sits on the modes' places −n/2 … n/2−1; each stands for its cell."""
    odd = grid_mask(13.56e-3, 41, 300e-6)
    np.testing.assert_allclose(odd.positions.min(axis=0), [-6e-3, -6e-3])
    np.testing.assert_allclose(odd.positions.max(axis=0), [6e-3, 6e-3])
    even = grid_mask(13.56e-3, 226, 60e-6)
    np.testing.assert_allclose(even.positions.min(axis=0), -6.78e-3)
    np.testing.assert_allclose(even.positions.max(axis=0), 6.72e-3)
    np.testing.assert_allclose(odd.weights, 300e-6**2, rtol=1e-12)
    assert odd.sensed_area == pytest.approx((41 * 300e-6) ** 2, rel=1e-12)
    assert even.sensed_area == pytest.approx(13.56e-3**2, rel=1e-12)


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        ([[0, 0], [0, 6e-3]], r"positions\[1\] is \(0, 6\) mm; allowed: within the aperture, ±5 mm"),
        ([[0, float("nan")]], "finite"),
        ([0.0, 1.0], r"\(M, 2\)"),
        (np.empty((0, 2)), r"positions is an array of shape \(0, 2\); .*at least 1"),
        ([], r"positions is an array of shape \(0,\); allowed: \(M, 2\).*at least 1"),
    ],
)
def test_points_that_make_no_mask_are_refused(positions, message):
    """Points beyond the aperture, NaN or of a wrong shape are named."""
    with pytest.raises(InvalidInput, match=message):
        custom_mask(positions, aperture=10e-3)


def test_weight_ratio_doctest_examples_pass():
    class Shown:
        __doc__ = Mask.weight_ratio.__doc__

    (examples,) = doctest.DocTestFinder().find(Shown, "weight_ratio", globs={})
    assert len(examples.examples) == 3
    assert doctest.DocTestRunner(verbose=False).run(examples).failed == 0


def test_a_mask_survives_json():
    """A mask written as JSON is read back as the same mask."""
    mask = grid_mask(1e-2, 5, 1e-3)
    again = Mask.model_validate_json(mask.model_dump_json())
    assert again.id == mask.id
    np.testing.assert_array_equal(again.positions, mask.positions)


def test_a_mask_cannot_be_changed():
    """Neither its fields nor its arrays can be overwritten."""
    mask = grid_mask(1e-2, 5, 1e-3)
    with pytest.raises(ValueError, match="frozen"):
        mask.aperture = 2.0
    with pytest.raises(ValueError, match="read-only"):
        mask.positions[0, 0] = 1.0
