"""Repeated frames and excitation wavelengths as part of a plan."""

import pytest

from steradian.core.exceptions import InvalidInput
from steradian.masks import grid_mask
from steradian.plans import ScanPlan, preview


@pytest.fixture(scope="module")
def plan():
    return ScanPlan.create(mask=grid_mask(aperture=6e-3, count=11, interval=300e-6))


def test_frames_of_one_wavelength_follow_each_other(plan):
    several = plan.replace(frames=2, excitation=(700e-9, 900e-9))
    assert several.frame_excitation == (700e-9, 700e-9, 900e-9, 900e-9)
    assert several.aline_count == 4 * plan.mask.count
    assert plan.frame_excitation == (0.0,), "the laser stays as it stands"


def test_plan_id_changes_with_multiple_frames_or_excitation(plan):
    assert plan.replace(frames=1).id == plan.id
    others = [plan.replace(frames=2), plan.replace(excitation=(700e-9,)), plan.replace(excitation=(800e-9,))]
    assert len({plan.id, *(other.id for other in others)}) == 4
    assert ScanPlan.model_validate_json(others[1].model_dump_json()).id == others[1].id


def test_the_preview_counts_every_frame(plan):
    one, six = preview(plan), preview(plan.replace(frames=3, excitation=(700e-9, 900e-9)))
    assert six.bytes == 6 * one.bytes
    assert six.laser_seconds == pytest.approx(6 * one.laser_seconds)
    assert six.total_seconds == pytest.approx(6 * one.total_seconds, rel=0.02)
    assert six.travel == pytest.approx(6 * one.travel)


@pytest.mark.parametrize("excitation", [(100e-9,), (5e-6,), (700e-9, 700e-9), (float("nan"),)])
def test_wavelengths_that_make_no_sense_are_refused(plan, excitation):
    with pytest.raises(InvalidInput, match="excitation"):
        plan.replace(excitation=excitation)


def test_no_frames_are_no_plan(plan):
    with pytest.raises(InvalidInput, match="frames"):
        plan.replace(frames=0)
