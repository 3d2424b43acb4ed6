"""Judgement of a running scan's images by the stopping rule of its plan.

For the process that computes stages: it keeps the growing image of one scan from one call to the next.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from steradian.plans import ScanPlan
from steradian.quality.stopping_rule import RevisionImage, StopDecision, StoppingRule, decide
from steradian.reconstructions.live.follow import LiveReconstruction
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.volumes.near_field import near_field_depth
from steradian.reconstructions.volumes.projections import project_below_depth
from steradian.scans.file.tail import has_alines

STEP = 0.04
"""Share of the points between two images."""


@dataclass
class _GrowingScan:
    """Image of one scan and its revisions."""

    path: Path
    view: LiveReconstruction
    revisions: list[RevisionImage] = field(default_factory=list)


_GROWING: dict[Path, _GrowingScan] = {}


def judge(path: Path, plan: ScanPlan) -> str:
    """Return why a scan has enough points, in words; empty: it has not, or it has few more than at the last call.

    Parameters
    ----------
    path
        The scan file, which another process writes to.
    plan
        Its plan, with a stopping rule and without further stages.
    """
    if plan.stopping is None or not has_alines(path):
        return ""
    growing = _GROWING.get(path)
    if growing is None:
        _GROWING.clear()
        view = LiveReconstruction(path, path.parent, ReconstructionParameters())
        growing = _GROWING[path] = _GrowingScan(path, view)
    growing.view.add_new()
    if growing.view.points >= plan.mask.count:
        return ""
    least = growing.revisions[-1].points if growing.revisions else 0
    if growing.view.points < least + STEP * plan.mask.count:
        return ""
    growing.revisions.append(RevisionImage(growing.view.points, _projection(growing.view)))
    rule = StoppingRule(**plan.stopping.model_dump())
    decision = decide(rule, growing.revisions, plan.mask.count)
    return describe(decision, rule) if decision.stop else ""


def describe(decision: StopDecision, rule: StoppingRule) -> str:
    """Return the reason of a decision to stop in words."""
    match decision.reason:
        case "gain":
            return f"enough: the rest raises the correlation by {decision.gain:.2g} at most (rule: {rule.max_gain:g})"
        case "change":
            return f"enough: the rest changes the image by {decision.change:.2g} at most (rule: {rule.max_change:g})"
        case "noise":
            return f"enough: the image's error is at {decision.noise_db:.0f} dB (rule: {rule.max_noise_db:g} dB)"
    return f"enough: {rule.max_points} points, as many as agreed to"


def _projection(view: LiveReconstruction) -> NDArray[Any]:
    volume = view.volume()
    beyond, _ = project_below_depth(volume, near_field_depth(volume, view.whole.positions))
    return beyond["z"]
