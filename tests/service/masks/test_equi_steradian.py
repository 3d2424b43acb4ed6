"""Equi-steradian masks keep the paper's promises."""

import numpy as np
import pytest
from scipy.spatial import SphericalVoronoi

from steradian import InvalidInput, equi_steradian_mask
from steradian.masks import convenient_counts

APERTURE, DEPTH = 13.56e-3, 3.6e-3


def test_the_papers_mask_has_the_papers_count_and_weight_ratio():
    """Asking 1,600 points gives 1,605; the outermost weighs about 9.7 times the innermost (paper, section 5)."""
    mask = equi_steradian_mask(APERTURE, DEPTH, 1600)
    assert mask.count == 1605
    assert mask.arrangement["slices"] == [1, 4, 8, 8] + 3 * [16] + 8 * [32] + 20 * [64]
    assert mask.weight_ratio == pytest.approx(9.7, abs=0.7)


@pytest.mark.parametrize("count", [60, 400, 1600, 6000])
def test_every_point_covers_about_the_same_solid_angle(count):
    """Voronoi cells on the sphere around the point of interest are equal where the rim does not cut them."""
    mask = equi_steradian_mask(APERTURE, DEPTH, count)
    rays = np.column_stack([mask.positions, np.full(mask.count, DEPTH)])
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    slices = np.repeat(np.arange(len(mask.arrangement["slices"])), mask.arrangement["slices"])
    areas = SphericalVoronoi(rays).calculate_areas()[slices < slices.max() - 1]
    assert areas.std() / areas.mean() < 0.12
    cap = 2 * np.pi * (1 - DEPTH / np.hypot(DEPTH, APERTURE / 2))
    assert areas.mean() == pytest.approx(cap / mask.count, rel=0.05)


def test_weights_are_areas_of_the_aperture():
    """Σh = X² and h ∝ r³, r from the point of interest (paper, section 4.2)."""
    mask = equi_steradian_mask(APERTURE, DEPTH, 300)
    assert mask.weights.sum() == pytest.approx(APERTURE**2, rel=1e-12)
    distance = np.sqrt((mask.positions**2).sum(axis=1) + DEPTH**2)
    assert np.ptp(mask.weights / distance**3) < 1e-9 * (mask.weights / distance**3).max()


def test_points_stay_within_the_inscribed_disc_and_apart():
    """No point lies beyond the rim and no two coincide."""
    mask = equi_steradian_mask(APERTURE, DEPTH, 1600)
    assert np.linalg.norm(mask.positions, axis=1).max() < APERTURE / 2
    gaps = np.linalg.norm(mask.positions[:, None] - mask.positions[None], axis=2)
    assert gaps[~np.eye(mask.count, dtype=bool)].min() > 0.5 * np.sqrt(mask.weights.min() * np.pi / 4)


def test_neighbouring_convenient_counts_are_offered():
    """1,625 is not reachable; 1,605 and 1,669 are the counts beside it."""
    assert convenient_counts(APERTURE, DEPTH, 1625) == (1605, 1669)


def test_same_parameters_same_identifier():
    """A mask is identified by its content."""
    assert equi_steradian_mask(APERTURE, DEPTH, 300).id == equi_steradian_mask(APERTURE, DEPTH, 300).id
    assert equi_steradian_mask(APERTURE, DEPTH, 300).id != equi_steradian_mask(APERTURE, DEPTH, 200).id


@pytest.mark.parametrize(
    ("parameters", "field", "allowed"),
    [
        ({"depth": -1e-3}, "depth", "> 0"),
        ({"depth": float("nan")}, "depth", "> 0"),
        ({"aperture": 0}, "aperture", "> 0"),
        ({"count": 2}, "count", "at least 5"),
    ],
)
def test_bad_parameters_name_field_value_and_range(parameters, field, allowed):
    """A wrong parameter is refused with its name and what is allowed."""
    with pytest.raises(InvalidInput) as refused:
        equi_steradian_mask(**({"aperture": APERTURE, "depth": DEPTH, "count": 300} | parameters))
    assert refused.value.field == field
    assert allowed in refused.value.allowed
