"""Plans of several beams: places are visited, not points; times, wavelengths and identity follow."""

import numpy as np
import pytest

from steradian import InvalidInput, ScanPlan, equi_steradian_mask
from steradian.masks import multi_beam_mask
from steradian.masks.multi_beam import read_beams
from steradian.plans import Fringe, Link, VisitOrder, preview
from steradian.plans.files import read_json, write_json

BEAMS = read_beams("3x2", 0.7e-3)
FREE = Link(byte_rate=None)


@pytest.fixture(scope="module")
def alone():
    return equi_steradian_mask(13.56e-3, 3.6e-3, 120)


@pytest.fixture(scope="module")
def mask(alone):
    return multi_beam_mask(alone, BEAMS)


@pytest.mark.long
@pytest.mark.parametrize("order", ["given", "snake", "hilbert", "shortest"])
def test_a_place_is_visited_once_with_all_its_beams_in_their_order(mask, order):
    plan = ScanPlan.create(mask=mask, beams=BEAMS, order=order)
    visit = plan.visit.reshape(-1, 6)
    assert sorted(visit[:, 0]) == list(range(0, mask.count, 6))
    assert (np.diff(visit, axis=1) == 1).all()
    np.testing.assert_array_equal(plan.path, mask.positions[visit[:, 0]])


def test_the_time_is_that_of_the_places(alone, mask):
    one, several = (
        preview(ScanPlan.create(mask=each, beams=beams, link=FREE, averages=2))
        for each, beams in ((alone, ()), (mask, BEAMS))
    )
    assert several.total_seconds == pytest.approx(mask.count / 6 * 2 / 50)
    assert several.total_seconds / one.total_seconds == pytest.approx(mask.count / 6 / alone.count)
    assert several.bytes == mask.count * 1024 * 2
    assert (one.beams, one.displacement) == (1, {})
    assert (several.beams, several.displacement) == (6, mask.arrangement["displacement"])


def test_all_beams_of_a_place_are_read_at_one_wavelength_and_the_loss_of_each_is_stated(mask):
    best = 1.55e-6 + 4e-5 * mask.positions[:, 0] * 1e-3 / 7e-3  # a wedge
    fringe = Fringe()
    plan = ScanPlan.create(
        mask=mask, beams=BEAMS, wavelengths=best, order="bands", max_sensitivity_loss=0.05, link=FREE, fringe=fringe
    )
    bias = plan.bias.reshape(-1, 6)
    assert (bias == bias[:, :1]).all()
    lost = np.maximum(fringe.sensitivity_loss(plan.bias - best), 0)
    assert preview(plan).sensitivity_loss["max"] == pytest.approx(lost.max())
    assert lost.max() > fringe.sensitivity_loss(plan.bias[::6] - best.reshape(-1, 6).mean(axis=1)).max()


def test_single_beam_plan_keeps_id_and_multi_beam_plan_round_trips(alone, mask, tmp_path):
    plan = ScanPlan.create(mask=mask, beams=BEAMS)
    assert ScanPlan.create(mask=alone, beams=()).id == ScanPlan.create(mask=alone).id
    assert plan.id != ScanPlan.create(mask=mask).id
    write_json(plan, tmp_path / "plan.json")
    assert read_json(ScanPlan, tmp_path / "plan.json").id == plan.id
    assert f"{mask.count} points by 6 beams" in repr(plan)


def test_points_that_are_not_of_the_beams_and_orders_of_single_points_are_refused(alone, mask):
    with pytest.raises(InvalidInput, match="multi_beam_mask"):
        ScanPlan.create(mask=alone, beams=BEAMS)
    with pytest.raises(InvalidInput, match=r"beams\[0\]"):
        ScanPlan.create(mask=mask, beams=[(1e-3, 0), *BEAMS[1:]])
    with pytest.raises(InvalidInput, match="order"):
        ScanPlan.create(mask=mask, beams=BEAMS, order=VisitOrder.PROGRESSIVE)


def test_only_the_first_beam_must_be_within_the_scanners_reach(mask):
    low, high = mask.positions[::6].min(axis=0), mask.positions[::6].max(axis=0)
    reach = {"x": (low[0], high[0]), "y": (low[1], high[1])}
    assert not preview(ScanPlan.create(mask=mask, beams=BEAMS, scanner=reach, link=FREE)).has_errors
    assert preview(ScanPlan.create(mask=mask, scanner=reach, link=FREE)).has_errors
