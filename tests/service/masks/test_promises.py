"""What a mask promises is what it then does."""

from math import degrees, hypot, radians, sqrt

import numpy as np
import pytest

from steradian import InvalidInput, equi_steradian_mask, grid_mask
from steradian.masks import equiangular_mask
from steradian.masks.film_attenuation import attenuation_db
from steradian.masks.limited_view import limited_view, visible_fraction
from steradian.masks.metrics import evaluate_mask
from steradian.masks.plots import draw_mask
from steradian.masks.point_spread import point_spread
from steradian.masks.weights import resolve_outline

APERTURE, DEPTH = 13.56e-3, 3.6e-3
MASK = equi_steradian_mask(APERTURE, DEPTH, 1600)


def test_the_papers_mask_opens_by_the_papers_angle():
    """The largest angle of incidence is 62° (paper, section 4.2), the opening twice that."""
    seen = evaluate_mask(MASK)
    assert degrees(seen.largest_angle) == pytest.approx(62, abs=0.5)
    assert degrees(seen.opening_angle) == pytest.approx(124, abs=1)
    assert seen.attenuation_db == pytest.approx(5, abs=0.1)
    assert seen.evenness < 0.06
    assert seen.weight_ratio == MASK.weight_ratio


def test_figures_that_need_a_point_of_interest_are_left_out_without_one():
    """A grid promises a spacing; with a point of interest given also angles."""
    grid = grid_mask(1e-2, 11, 5e-4)
    assert evaluate_mask(grid).solid_angles is None
    assert evaluate_mask(grid).finest == pytest.approx(5e-4)
    seen = evaluate_mask(grid, (0.0, 0.0, 2e-3))
    assert seen.largest_angle == pytest.approx(np.arctan(np.hypot(2.5e-3, 2.5e-3) / 2e-3))
    with pytest.raises(InvalidInput, match="z > 0"):
        evaluate_mask(grid, (0, 0, 0))


def test_no_plane_sees_edges_perpendicular_to_itself():
    """Visible tilts stay below 90°, shrink with depth, and outside the sensors even flat edges disappear."""
    view = limited_view(grid_mask(1e-2, 51, 1e-4), deepest=2e-2)
    assert np.degrees(np.maximum(view.steepest_left, view.steepest_right)).max() < 90
    middle = len(view.x) // 2
    assert (np.diff(view.share[middle]) < 0).all()
    assert np.degrees(view.steepest_right[middle, -1]) == pytest.approx(degrees(np.arctan(2.5 / 20)), abs=1)
    outside = ~view.detection_region[:, 0]
    assert outside.any()
    assert (np.minimum(view.steepest_left, view.steepest_right)[outside] < 0).all()


def test_right_below_the_sensors_all_orientations_of_a_half_space_are_seen():
    """The share of visible orientations tends to one at the film, and to the solid angle far away."""
    view = limited_view(grid_mask(1e-2, 100, 1e-4), deepest=0.5, pixels=500)
    middle = len(view.x) // 2
    assert view.share[middle, 0] > 0.8
    assert view.share[middle, -1] == pytest.approx((1e-2 / view.z[-1]) ** 2 / (2 * np.pi), rel=0.05)


def test_disc_visible_fraction_and_edges_match_closed_forms():
    """On the axis of a disc with half-angle α it is 1 − cos α, and at y the steepest edge is that of its chord."""
    mask = equi_steradian_mask(13.56e-3, 3.6e-3, 400)
    radius = sqrt(mask.weights.sum() / np.pi)
    assert visible_fraction(mask, (0, 0, 3.6e-3)) == pytest.approx(1 - 3.6e-3 / hypot(radius, 3.6e-3), abs=1e-3)
    view = limited_view(mask, deepest=8e-3, y=0.8 * radius, pixels=101)
    assert np.tan(view.steepest_right[50]) * view.z == pytest.approx(0.6 * radius, rel=1e-3)
    passes_by = limited_view(mask, deepest=8e-3, y=1.01 * radius)
    assert (passes_by.steepest_left < 0).all()
    assert not passes_by.detection_region.any()


def test_a_section_along_either_edge_of_the_aperture_meets_all_of_it():
    mask = grid_mask(1e-2, 51, 1e-4)
    lower, upper = (limited_view(mask, deepest=8e-3, y=y).ends for y in np.unique(resolve_outline(mask)[:, 1]))
    assert lower == pytest.approx((-51 * 0.5e-4, 51 * 0.5e-4))
    assert upper == lower


def test_film_attenuation_matches_published_values():
    """At 62° about 5 dB at 1 MHz and 10 dB at 2 MHz, nothing at normal incidence."""
    assert attenuation_db(0, 1e6) == 0
    assert attenuation_db(radians(62), 1e6) == pytest.approx(5)
    assert attenuation_db(radians(62), 2e6) == pytest.approx(10)
    with pytest.raises(InvalidInput, match="2e6"):
        attenuation_db(0.1, 5e6)
    with pytest.raises(InvalidInput, match="π/2"):
        attenuation_db(2, 1e6)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (2e-3, -1e-3)])
def test_a_tiny_ball_shows_at_its_place_with_about_its_size(offset):
    """The point-spread preview finds the ball within its width, and little elsewhere."""
    spread = point_spread(equi_steradian_mask(8e-3, 2e-3, 300, offset=offset), width=200e-6)
    top = np.unravel_index(spread.section.argmax(), spread.section.shape)
    assert spread.x[top[0]] == pytest.approx(offset[0], abs=100e-6)
    assert spread.z[top[1]] == pytest.approx(2e-3, abs=100e-6)
    assert 100e-6 < spread.axial < 250e-6
    assert 150e-6 < spread.lateral < 400e-6
    assert 0.3 < spread.peak < 1.2
    assert spread.background < 0.1


def test_a_small_aperture_shows_as_much_around_the_ball_as_any():
    """Ten widths below the ball, though no sensor is so far from it."""
    spread = point_spread(grid_mask(2e-3, 11, 180e-6), (0.0, 0.0, 1e-3))
    assert spread.z[-1] == pytest.approx(2.5e-3, abs=20e-6)


def test_a_point_spread_needs_a_point():
    """Without a point of interest it has to be given."""
    with pytest.raises(InvalidInput, match="point"):
        point_spread(grid_mask(1e-2, 5, 1e-3))


@pytest.mark.long
@pytest.mark.parametrize(
    "mask", [equi_steradian_mask(8e-3, 2e-3, 100), equiangular_mask(1e-2, 2e-3, 30), grid_mask(1e-2, 5, 1e-3)]
)
def test_any_mask_can_be_drawn(mask, tmp_path):
    """A PNG is written whole."""
    draw_mask(mask, tmp_path / "mask.png")
    assert (tmp_path / "mask.png").read_bytes()[:4] == b"\x89PNG"
    assert [path.name for path in tmp_path.iterdir()] == ["mask.png"]


def test_a_wide_ball_is_sampled_as_finely_as_it_needs():
    """Its image is that of samples four times as close, and not of the tens of thousands that a small ball needs."""
    mask, place = equi_steradian_mask(0.05, 0.03, 60), (0.0, 0.0, 0.03)
    found, finer = (point_spread(mask, place, width=7e-3, sampling_interval=each) for each in (None, 7e-8))
    assert (found.lateral, found.axial) == pytest.approx((finer.lateral, finer.axial), rel=0.01)
    assert len(found.z) < 400
