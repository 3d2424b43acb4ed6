"""Voronoi weights are areas of real cells within what is sensed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from steradian import custom_mask, equi_steradian_mask, grid_mask
from steradian.masks import voronoi_areas, with_weights


@settings(max_examples=40, deadline=None)
@given(count=st.integers(1, 200), seed=st.integers(0, 999), twins=st.booleans())
def test_cells_fill_the_aperture(count, seed, twins):
    """Areas are positive and sum to the aperture for any points, also where some lie at the same place."""
    points = np.random.default_rng(seed).random((count, 2)) - 0.5
    if twins:
        points = np.concatenate([points, points[:3]])
    areas = voronoi_areas(points, 1.0)
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize(
    "mask",
    [equi_steradian_mask(1.0, 0.3, 60), grid_mask(1.0, 6, 0.1), custom_mask([[-0.5, -0.5], [0.5, 0.5], [0, 0]], 1.0)],
    ids=["points on the rim", "equal distances", "points in the corners"],
)
def test_voronoi_areas_match_monte_carlo(mask):
    """Of many random places, each cell holds the share that its area says."""
    darts = np.random.default_rng(0).random((200_000, 2)) - 0.5
    hits = np.bincount(KDTree(mask.positions).query(darts)[1], minlength=mask.count) / len(darts)
    assert np.abs(voronoi_areas(mask.positions, 1.0) - hits).max() < 5 * np.sqrt(hits.max() / len(darts))


def test_cells_of_a_line_are_its_midpoint_segments():
    """On a line a cell goes from midpoint to midpoint, at the ends to the end of the line."""
    np.testing.assert_allclose(voronoi_areas(np.array([[0.1], [-0.3], [0.4]]), 1.0), [0.35, 0.4, 0.25])


def test_analytic_weights_agree_with_the_cells():
    """The weights h ∝ r³ are the areas of the cells but at the rim, whose last slice takes 3 % from the others."""
    paper, cells = (equi_steradian_mask(13.56e-3, 3.6e-3, 1600, weighting=rule) for rule in ("analytic", "voronoi"))
    inner = np.linalg.norm(paper.positions, axis=1) < 5e-3
    ratio = (paper.weights / cells.weights)[inner]
    assert ratio.std() / ratio.mean() < 0.06
    assert ratio.mean() == pytest.approx(0.97, abs=0.01)


def test_reweighting_preserves_positions_and_sensed_area():
    """Other weights make another mask of the same points."""
    mask = equi_steradian_mask(1e-2, 3e-3, 100)
    uniform, cells = with_weights(mask, "uniform"), with_weights(mask, "voronoi")
    assert uniform.weight_ratio == pytest.approx(1)
    np.testing.assert_allclose(cells.weights, mask.weights, rtol=1e-12)
    assert uniform.sensed_area == pytest.approx(mask.sensed_area, rel=1e-12)
    assert mask.id == cells.id != uniform.id
    np.testing.assert_array_equal(uniform.positions, mask.positions)
