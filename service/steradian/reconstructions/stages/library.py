"""Plans of adaptive scans: a survey with a focus stage, and the focus planned from the scan file of a survey."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from steradian.core.exceptions import InvalidInput
from steradian.plans import ScanPlan
from steradian.plans.stages import FocusStage, StoppingRule
from steradian.reconstructions.scan import Scan
from steradian.reconstructions.stages.planner import next_plan, propose

Places = Sequence[Sequence[float]]


def survey(
    aperture: float,
    points: int = 200,
    further: int = 1400,
    *,
    stopping: StoppingRule | None = None,
    plan: dict[str, Any] | None = None,
    **rule: Any,
) -> ScanPlan:
    """Return a plan in stages: an even survey of the aperture, then a focus on points of interest in its image.

    Parameters
    ----------
    aperture
        Side X of the square aperture in metres.
    points
        Points of the survey; the Poisson-disc mask may miss them by a few.
    further
        Points of the focus, at most.
    stopping
        Rule that ends the scan early; the order of the plan must then be progressive.
    plan
        Fields of :class:`steradian.ScanPlan`, such as ``pulse_rate`` (Hz) or ``samples``.
    rule
        Fields of :class:`steradian.plans.stages.FocusStage`: ``choice``, ``count``, ``decision``, …

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.

    Examples
    --------
    >>> import steradian
    >>> steradian.survey(13.56e-3, 100, 300, choice="nearest").most_points
    399
    """
    from steradian.masks.staged import survey_mask

    stage = FocusStage.create(points=further, **rule)
    return ScanPlan.create(mask=survey_mask(aperture, points), stages=(stage,), stopping=stopping, **(plan or {}))


def focus(
    scan: Scan | str | Path, points: int | None = None, *, points_of_interest: Places | None = None, **rule: Any
) -> ScanPlan:
    """Return the plan of the next stage of a scan whose points so far are measured.

    For a scanner that Steradian does not run: the plan's mask begins with the points of the scan, and those behind
    ``plan.stage_ends[-1]`` are the further ones, to be measured next.

    Parameters
    ----------
    scan
        Scan, or path of its file.
    points
        Further points, at most; ``None``: as many as the scan's plan says.
    points_of_interest
        (P, 3) x, y and depth in metres; ``None``: found in the image of the scan.
    rule
        Fields of :class:`steradian.plans.stages.FocusStage`, which replace those of the scan's plan.

    Raises
    ------
    InvalidInput
        When nothing stands above the noise of the image, or naming the parameter and its allowed range.
    DamagedFile
        When the file cannot be read as a scan, or holds no A-line.
    """
    scan = scan if isinstance(scan, Scan) else Scan(scan)
    plan = scan.plan
    if not plan.stages and points is None:
        raise InvalidInput("points", None, "a number of further points, for a scan of one stage")
    before = dict(plan.stages[0]) if plan.stages else {}
    stage = FocusStage.create(**before | rule | ({} if points is None else {"points": points}))
    plan = plan.replace(stages=(stage, *plan.stages[1:]))
    places = tuple((float(x), float(y), float(z)) for x, y, z in points_of_interest or stage.points_of_interest)
    if not places:
        places = tuple(each.position for each in propose(scan.path, stage))
    if not places:
        raise InvalidInput("points_of_interest", "none found in the image", "given, or a smaller least_signal_to_noise")
    return next_plan(plan, places)
