"""Masks of scans in stages: measured points kept, further ones equi-steradian around what was found."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from steradian.core.exceptions import InvalidInput
from steradian.imaging.geometry import polygons
from steradian.masks import Mask, PointOfInterest, combined_mask, equi_steradian_mask, grid_mask, multi_beam_mask
from steradian.masks.expected_focus import expected_focus
from steradian.masks.staged import extend_mask, survey_mask

APERTURE = 13.56e-3
PLACE = (2.6e-3, -1.8e-3, 2e-3)
SURVEY = survey_mask(APERTURE, 100)
STAGED = extend_mask(SURVEY, [PLACE], 300, seed=3)


def solid_angles(mask, point, count=200_000):
    """Return the solid angle (M,) that is nearer to each point than to others, by directions drawn at random."""
    random = np.random.default_rng(0)
    cosine, turn = 1 - random.random(count), 2 * np.pi * random.random(count)
    radius = point[2] * np.sqrt(1 / cosine**2 - 1)
    met = np.array(point[:2]) + (radius * np.array([np.cos(turn), np.sin(turn)])).T
    met = met[np.abs(met).max(axis=1) <= mask.aperture / 2]
    return np.bincount(KDTree(mask.positions).query(met)[1], minlength=mask.count) * (2 * np.pi / count)


def test_survey_has_about_its_count_and_leaves_no_gap():
    places = np.random.default_rng(0).uniform(-APERTURE / 2, APERTURE / 2, (20_000, 2))
    gap = KDTree(SURVEY.positions).query(places)[0].max()
    assert abs(SURVEY.count - 100) <= 3
    assert gap < 1.1 * APERTURE / 10
    assert KDTree(SURVEY.positions).query(SURVEY.positions, 2)[0][:, 1].min() > 0.6 * APERTURE / 10


@pytest.mark.parametrize("place", [PLACE, (0.0, 0.0, 3.6e-3), (-6.78e-3, 6.78e-3, 1e-3), (0.0, 0.0, 20e-3)])
def test_extended_mask_keeps_the_measured_points_and_adds_the_count(place):
    mask = extend_mask(SURVEY, [place], 150)
    assert mask.positions[: SURVEY.count].tobytes() == SURVEY.positions.tobytes()
    assert mask.count == SURVEY.count + 150
    assert np.abs(mask.positions).max() <= APERTURE / 2
    assert (mask.depth, mask.offset) == (place[2], place[:2])


def test_points_of_both_stages_see_the_place_under_equal_solid_angles():
    angles = solid_angles(STAGED, PLACE)
    near = np.linalg.norm(STAGED.positions - PLACE[:2], axis=1) < 3e-3
    reference = equi_steradian_mask(APERTURE, PLACE[2], STAGED.count, offset=PLACE[:2])
    assert near[: SURVEY.count].sum() >= 5, "points of the survey are among them"
    assert angles[near].std() / angles[near].mean() < 0.2
    assert angles[near].mean() == pytest.approx(solid_angles(reference, PLACE)[:100].mean(), rel=0.3)
    assert solid_angles(SURVEY, PLACE).std() / solid_angles(SURVEY, PLACE).mean() > 1


def test_no_further_point_is_wasted_on_a_measured_one():
    apart = KDTree(STAGED.positions).query(STAGED.positions, 2)[0][:, 1]
    distance = np.sqrt(((STAGED.positions - PLACE[:2]) ** 2).sum(axis=1) + PLACE[2] ** 2)
    angles = solid_angles(STAGED, PLACE)
    spacing = np.sqrt(np.median(angles[angles > 0]) * distance**3 / PLACE[2])
    assert (apart / spacing)[SURVEY.count :].min() > 0.35


def test_weights_are_the_areas_of_the_cells_of_all_points():
    places = np.random.default_rng(1).uniform(-APERTURE / 2, APERTURE / 2, (400_000, 2))
    counted = np.bincount(KDTree(STAGED.positions).query(places)[1], minlength=STAGED.count)
    assert STAGED.sensed_area == pytest.approx(APERTURE**2)
    assert np.abs(STAGED.weights * len(places) / APERTURE**2 - counted).max() < 6 * np.sqrt(counted.max())


def test_extended_mask_states_its_stages():
    assert STAGED.arrangement == {
        "arrangement": "staged",
        "survey": SURVEY.arrangement,
        "stage_ends": [SURVEY.count],
        "points_of_interest": [{"depth": PLACE[2], "offset": list(PLACE[:2])}],
        "points_in_stage": [1],
        "seed": 3,
    }


def test_mask_extended_twice_states_both_stages_and_keeps_all_points():
    again = extend_mask(STAGED, [(-3e-3, 0.0, 3e-3), (3e-3, 3e-3, 4e-3)], 200)
    assert again.positions[: STAGED.count].tobytes() == STAGED.positions.tobytes()
    assert again.arrangement["stage_ends"] == [SURVEY.count, STAGED.count]
    assert again.arrangement["survey"] == SURVEY.arrangement
    assert again.arrangement["points_in_stage"] == [1, 2]
    assert again.points_of_interest.tolist() == [list(PLACE), [-3e-3, 0.0, 3e-3], [3e-3, 3e-3, 4e-3]]
    assert (again.depth, again.offset) == (PLACE[2], PLACE[:2])
    assert again.sensed_area == pytest.approx(APERTURE**2)


def test_several_places_are_each_sensed_densely():
    places = [(-4e-3, -3e-3, 2e-3), (4e-3, 3e-3, 2e-3)]
    mask = extend_mask(SURVEY, places, 500)
    share = [(np.linalg.norm(mask.positions - place[:2], axis=1) < 2e-3).sum() for place in places]
    middle = (np.linalg.norm(mask.positions, axis=1) < 2e-3).sum()
    assert min(share) > 0.85 * max(share)
    assert min(share) > 2 * middle


def test_mask_of_a_disc_stays_within_the_hull_of_all_discs():
    first = equi_steradian_mask(APERTURE, 2e-3, 100)
    mask = extend_mask(first, [(0.0, 0.0, 4e-3)], 100)
    assert np.linalg.norm(mask.positions, axis=1).max() <= APERTURE / 2 * 1.001
    assert mask.sensed_area == pytest.approx(np.pi * APERTURE**2 / 4, rel=1e-3)
    assert polygons.contains(mask.outline, mask.positions).all()


def test_same_seed_gives_the_same_mask():
    assert extend_mask(SURVEY, [PLACE], 300, seed=3).id == STAGED.id
    assert extend_mask(SURVEY, [PLACE], 300, seed=4).id != STAGED.id
    assert survey_mask(APERTURE, 100).id == SURVEY.id


LINE = Mask.create(aperture=1e-2, positions=np.array([[-1e-3], [1e-3]]), weights=np.array([5e-3, 5e-3]), arrangement={})
BEAMS = multi_beam_mask(grid_mask(1e-2, 10, 1e-3, centred=True), [(0.0, 0.0), (1e-3, 0.0)])


@pytest.mark.parametrize(
    ("mask", "places", "count", "field"),
    [
        (LINE, [PLACE], 100, "mask"),
        (BEAMS, [PLACE], 100, "mask"),
        (SURVEY, [(7e-3, 0.0, 2e-3)], 100, "points_of_interest.0.offset"),
        (SURVEY, [PLACE, (0.0, float("nan"), 2e-3)], 100, "points_of_interest.1.offset"),
        (SURVEY, [PLACE, (0.0, 0.0, 0.0)], 100, "points_of_interest.1.depth"),
        (SURVEY, [(0.0, 0.0, 2.0)], 100, "points_of_interest.0.depth"),
        (SURVEY, [], 100, "points_of_interest"),
        (SURVEY, [PLACE] * 9, 100, "points_of_interest"),
        (SURVEY, [PLACE], 4, "count"),
        (SURVEY, [PLACE], 1_000_000, "count"),
    ],
)
def test_extend_mask_refuses_and_names_the_field(mask, places, count, field):
    with pytest.raises(InvalidInput) as error:
        extend_mask(mask, places, count)
    assert error.value.field == field


def test_expected_focus_is_better_with_the_focus_than_with_the_survey():
    survey, place = survey_mask(6e-3, 40), (1e-3, -0.5e-3, 1.5e-3)
    before, after = expected_focus(survey, place), expected_focus(extend_mask(survey, [place], 160), place)
    assert after.contrast_db > before.contrast_db + 6
    assert after.spacing_m < before.spacing_m / 2
    assert 150e-6 <= after.lateral_m < 220e-6
    assert 90e-6 <= after.axial_m < 160e-6


def test_expected_focus_states_the_solid_angle_of_the_aperture():
    half, depth = 3e-3, 2e-3
    square = 4 * np.arctan(half**2 / (depth * np.sqrt(2 * half**2 + depth**2)))
    share = expected_focus(survey_mask(2 * half, 100), (0.0, 0.0, depth)).solid_angle_share
    assert share == pytest.approx(square / 2 / np.pi, rel=0.03)


def test_density_is_that_of_combined_masks():
    places = [PointOfInterest(depth=2e-3, count=300, offset=(x, 0.0)) for x in (-3e-3, 3e-3)]
    wanted = combined_mask(APERTURE, places)
    mask = extend_mask(SURVEY, [(-3e-3, 0.0, 2e-3), (3e-3, 0.0, 2e-3)], wanted.count - SURVEY.count)
    for centre in ((-3e-3, 0.0), (0.0, 0.0), (3e-3, 0.0)):
        counts = [(np.linalg.norm(each.positions - centre, axis=1) < 2e-3).sum() for each in (mask, wanted)]
        assert counts[0] == pytest.approx(counts[1], rel=0.3)
