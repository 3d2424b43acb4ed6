"""Preview of a plan before the scan: cost and validation findings."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.plans.validation import PlanIssue, validate_plan
from steradian.plans.visit_order import path_length

if TYPE_CHECKING:
    from steradian.plans.plan import ScanPlan

BYTES_PER_SAMPLE = 2
BYTES_PER_ALINE = 40
"""What a scan file keeps of an A-line besides its samples."""
DISK_RATE = 20e6
"""Bytes per second that any disk writes durably."""

Part = Literal["laser", "mover", "tuning", "gate", "link", "disk"]

__all__ = ["PlanCost", "PlanIssue", "preview"]


@dataclass(frozen=True)
class PlanCost:
    """Preview of a plan: its duration, size and findings.

    Attributes
    ----------
    seconds
        Time each part needs by itself: ``laser`` (pulses), ``mover`` (moves and settling), ``tuning`` (of the bias
        wavelength), ``gate`` (edges that are waited for, if any), ``link`` (bytes over the line), ``disk`` (writes).
    laser_seconds
        ``seconds["laser"]``.
    total_seconds
        Time of the scan: the parts overlap, and a point waits for the next pulse of a laser that runs freely. Of a plan
        with further stages at most, as far apart as its own points are.
    least_seconds
        Time where the stopping rule ends the scan as early as it may; ``total_seconds`` without one.
    limiting
        The part that decides ``total_seconds``.
    travel
        Way of the beam in metres.
    retunings
        How often the bias wavelength changes.
    bands
        How many different bias wavelengths are set; 0: the scanner's own.
    sensitivity_loss
        Share of the film's sensitivity that points lose to wavelengths beside their best: ``max``, ``mean``, and
        ``expected``, the mean where the best wavelengths are as uncertain as the plan says; empty without wavelengths.
    beams
        How many interrogation beams record each shot.
    displacement
        How far the points of the mask that was asked for are from the nearest that a beam measures, in m: ``median``
        and ``largest``; empty with one beam.
    bytes
        Size of the A-lines' samples; the scan file is a few per cent larger.
    findings
        Remarks; an error refuses the scan.
    """

    seconds: dict[Part, float]
    laser_seconds: float
    total_seconds: float
    limiting: Part
    travel: float
    retunings: int
    bytes: int
    findings: tuple[PlanIssue, ...]
    bands: int = 0
    sensitivity_loss: dict[str, float] = field(default_factory=dict)
    beams: int = 1
    displacement: dict[str, float] = field(default_factory=dict)
    least_seconds: float | None = None

    @property
    def has_errors(self) -> bool:
        """Whether any finding is an error."""
        return any(finding.severity == "error" for finding in self.findings)


def preview(
    plan: ScanPlan,
    *,
    free_bytes: int | None = None,
    resolution: float | None = None,
    disk_rate: float = DISK_RATE,
) -> PlanCost:
    """Estimate the cost of a plan and validate it against scanner, link, record lengths and disk.

    Parameters
    ----------
    plan
        The plan.
    free_bytes
        Free space of the disk; ``None`` leaves it unchecked.
    resolution
        Wanted lateral resolution in metres; ``None`` leaves the lateral spacing unchecked.
    disk_rate
        Bytes per second that the disk writes durably.

    Notes
    -----
    :class:`~steradian.plans.motion_timing.MotionTiming` has the time of each point. Tuning the excitation laser
    between frames, and the way back to the first point, are not counted.
    """
    least, most = (plan.most_points,) * 2 if plan.stopping is None else plan.stopping.bounds(plan.most_points)
    share = most / plan.mask.count
    alines, period, frames = plan.frame_count * most, 1 / plan.pulse_rate, plan.frame_count
    points, shots = plan.path, alines // plan.beam_count
    bias = None if plan.bias is None else plan.bias[plan.visit[:: plan.beam_count]]
    retuning = np.zeros(len(points)) if bias is None else plan.pace.retune_times(bias)
    loop = share * frames * _frame_seconds(plan, (plan.pace.periods(points, bias) + plan.averages - 1) * period)
    size = alines * plan.samples * BYTES_PER_SAMPLE
    file_size = size + alines * BYTES_PER_ALINE
    seconds: dict[Part, float] = {
        "laser": shots * plan.averages * period,
        "mover": share * frames * float(plan.pace.move_times(points).sum()),
        "tuning": share * frames * float(retuning.sum()),
        "link": plan.link.seconds_of(alines, plan.samples),
        "disk": file_size / disk_rate,
    }
    if plan.gate != "none":
        seconds["gate"] = (frames if plan.gate == "frame" else shots) / plan.gate_rate
    way = share * frames * path_length(points, np.arange(len(points)))
    total = max(loop, seconds["link"], seconds["disk"])
    return PlanCost(
        seconds=seconds,
        laser_seconds=seconds["laser"],
        total_seconds=total,
        least_seconds=total * least / most,
        limiting=_bottleneck(seconds, loop),
        travel=way,
        retunings=round(share * frames * int((retuning > 0).sum())),
        bytes=size,
        findings=validate_plan(
            plan, alines_per_second=alines / loop, bytes_=file_size, free=free_bytes, resolution=resolution
        ),
        bands=0 if bias is None else len(np.unique(bias)),
        sensitivity_loss=_loss(plan),
        beams=plan.beam_count,
        displacement=plan.mask.arrangement.get("displacement", {}) if plan.beams else {},
    )


def _frame_seconds(plan: ScanPlan, each: NDArray[np.float64]) -> float:
    """Return the duration of a frame whose points take ``each`` (M,) s; gated points wait for a trigger edge."""
    if plan.gate == "none":
        return float(each.sum())
    waiting = each.sum(keepdims=True) if plan.gate == "frame" else each
    return float(np.ceil(waiting * plan.gate_rate - 1e-9).sum()) / plan.gate_rate


def _loss(plan: ScanPlan) -> dict[str, float]:
    """Return the sensitivity loss by the planned wavelengths, according to the film's fringe."""
    if plan.bias is None or plan.wavelengths is None:
        return {}
    detuning = plan.bias - plan.wavelengths
    lost = np.maximum(plan.fringe.sensitivity_loss(detuning), 0.0)
    expected = plan.fringe.expected_loss(detuning, plan.wavelength_uncertainty)
    return {"max": float(lost.max()), "mean": float(lost.mean()), "expected": float(expected.mean())}


def _bottleneck(seconds: dict[Part, float], loop: float) -> Part:
    """Return the bottleneck: a part that outlasts the loop of moves and shots, or else the longest within it."""
    outside: list[Part] = [part for part in ("link", "disk") if seconds[part] > loop]
    inside: list[Part] = ["laser", "mover", "tuning", "gate"]
    return max(outside or inside, key=lambda part: seconds.get(part, 0.0))
