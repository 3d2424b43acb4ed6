"""What a plan will cost, told before a pulse is fired."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from steradian.plans.order import travel
from steradian.plans.plan import ScanPlan

BYTES_PER_SAMPLE = 2


@dataclass(frozen=True)
class Finding:
    """One remark about a plan: an error refuses the scan, a warning does not."""

    severity: Literal["error", "warning"]
    field: str
    message: str


@dataclass(frozen=True)
class Preview:
    """Cost of a plan: laser time in seconds, mover travel in metres, bytes of A-lines, and remarks."""

    laser_seconds: float
    travel: float
    bytes: int
    findings: tuple[Finding, ...]


def preview(plan: ScanPlan) -> Preview:
    """Work out what a plan costs and whether its records reach what they should see."""
    mask = plan.mask
    pulses = mask.count * plan.averages
    return Preview(
        laser_seconds=pulses / plan.pulse_rate,
        travel=travel(mask.positions, plan.visit),
        bytes=mask.count * plan.samples * BYTES_PER_SAMPLE,
        findings=tuple(_reach(plan)),
    )


def _reach(plan: ScanPlan) -> list[Finding]:
    """Check that the farthest sensor's record is long enough to hear the point of interest."""
    if plan.mask.depth is None:
        return []
    farthest = float(np.hypot(np.linalg.norm(plan.mask.positions, axis=1).max(), plan.mask.depth))
    if farthest <= plan.recording_depth:
        return []
    needed = int(np.ceil(farthest / plan.sound_speed / plan.sampling_interval)) + 1
    return [
        Finding(
            "warning",
            "samples",
            f"{plan.samples} samples end before the farthest sensor hears the point of interest; at least {needed}",
        )
    ]
