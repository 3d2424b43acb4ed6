"""Plans of an adaptive acquisition: from any plan a survey with a focus stage, and the plan of the next stage."""

from __future__ import annotations

import numpy as np

from steradian.core.exceptions import InvalidInput
from steradian.masks import Mask
from steradian.masks.staged import survey_mask
from steradian.plans.plan import ScanPlan
from steradian.plans.stages import FEWEST_POINTS, FocusStage, StoppingRule, check_stages
from steradian.plans.tuning_map import TuningMap

FEWEST_SURVEYED = 16


def plan_in_stages(
    plan: ScanPlan, survey: int, *, focus: FocusStage | None = None, stopping: StoppingRule | None = None
) -> ScanPlan:
    """Return a plan of no more points than ``plan`` that begins with an evenly spread survey of its aperture.

    Parameters
    ----------
    plan
        Plan of one stage: the aperture, the number of points, and all that is the same for every point.
    survey
        Points of the survey.
    focus
        Rule of the second stage; its number of points is that of the plan less the survey's.
    stopping
        Rule that ends the scan early.

    Raises
    ------
    InvalidInput
        When the plan has stages already, or too few points.
    """
    if plan.stages or plan.stage_ends:
        raise InvalidInput("survey", survey, "none for a plan that has stages already")
    rule = focus or FocusStage(points=FEWEST_POINTS)
    check_stages((rule,), is_line=plan.mask.is_line, beams=plan.beam_count)
    most = plan.mask.count - FEWEST_POINTS
    if not FEWEST_SURVEYED <= survey <= most:
        raise InvalidInput("survey", survey, f"{FEWEST_SURVEYED} to {most} of the plan's {plan.mask.count} points")
    mask = survey_mask(plan.mask.aperture, survey, depth=plan.mask.depth, offset=plan.mask.offset)
    stage = rule.replace(points=plan.mask.count - mask.count)
    return _with_mask(plan, mask).replace(stages=(stage,), stopping=stopping)


def plan_of_next_stage(plan: ScanPlan, mask: Mask) -> ScanPlan:
    """Return the plan of the next stage, with a mask that extends the plan's.

    Raises
    ------
    InvalidInput
        When the mask has more points than were agreed to, does not begin with the plan's points, or is wider.
    """
    if not plan.stages:
        raise InvalidInput("stages", "none", "a plan with a further stage")
    count, most = plan.mask.count, plan.mask.count + plan.stages[0].points
    if not count < mask.count <= most:
        raise InvalidInput("mask", f"{mask.count} points", f"{count + 1} to {most}")
    if mask.aperture != plan.mask.aperture or not np.array_equal(mask.positions[:count], plan.mask.positions):
        raise InvalidInput("mask", "points elsewhere", "the points measured already, then further ones in the aperture")
    return _with_mask(plan, mask, stage_ends=(*plan.stage_ends, count), stages=plan.stages[1:])


def _with_mask(plan: ScanPlan, mask: Mask, **changes: object) -> ScanPlan:
    """Return the plan with another mask; bias wavelengths are interpolated between the plan's points."""
    if plan.wavelengths is not None:
        tuning = TuningMap.create(
            positions=plan.mask.film_positions, wavelengths=plan.wavelengths, repeatability=plan.wavelength_uncertainty
        )
        changes |= tuning.as_plan_fields(mask)
    return plan.replace(mask=mask, **changes)
