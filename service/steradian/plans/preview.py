"""What a plan will cost and what stands against it, told before a pulse is fired."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.plans.findings import Finding, find
from steradian.plans.order import travel

if TYPE_CHECKING:
    from steradian.plans.plan import ScanPlan

BYTES_PER_SAMPLE = 2
BYTES_PER_ALINE = 40
"""What a scan file keeps of an A-line besides its samples."""
DISK_RATE = 20e6
"""Bytes per second that any disk writes durably."""

Part = Literal["laser", "mover", "tuning", "link", "disk"]

__all__ = ["Finding", "Preview", "preview"]


@dataclass(frozen=True)
class Preview:
    """Cost of a plan, and remarks.

    Attributes
    ----------
    seconds
        Time each part needs by itself: ``laser`` (pulses), ``mover`` (moves and settling), ``tuning`` (of the bias
        wavelength), ``link`` (bytes over the line), ``disk`` (writes).
    laser_seconds
        ``seconds["laser"]``.
    total_seconds
        Time of the scan: the parts overlap, and a point waits for the next pulse of a laser that runs freely.
    limiting
        The part that decides ``total_seconds``.
    travel
        Way of the beam in metres.
    retunings
        How often the bias wavelength changes.
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
    findings: tuple[Finding, ...]

    @property
    def is_refused(self) -> bool:
        """Whether a finding is an error."""
        return any(finding.severity == "error" for finding in self.findings)


def preview(
    plan: ScanPlan,
    *,
    free_bytes: int | None = None,
    resolution: float | None = None,
    disk_rate: float = DISK_RATE,
) -> Preview:
    """Work out what a plan costs and whether scanner, link, records and disk can do it.

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
    The laser runs freely: a point is fired on at the first pulse after the beam has settled and the wavelength is
    stable, so a move a little longer than the pulse period costs a second period. Tuning the excitation laser between
    frames, and the way back to the first point, are not counted.
    """
    alines, period, frames = plan.aline_count, 1 / plan.pulse_rate, plan.frame_count
    moving, tuning = moving_seconds(plan), tuning_seconds(plan)
    waits = np.maximum(np.ceil((moving + tuning) * plan.pulse_rate - 1e-9), 1)
    loop = float(frames * waits.sum() + alines * (plan.averages - 1)) * period
    size = alines * plan.samples * BYTES_PER_SAMPLE
    file_size = size + alines * BYTES_PER_ALINE
    seconds: dict[Part, float] = {
        "laser": alines * plan.averages * period,
        "mover": frames * float(moving.sum()),
        "tuning": frames * float(tuning.sum()),
        "link": plan.link.seconds_of(alines, plan.samples),
        "disk": file_size / disk_rate,
    }
    way = frames * travel(plan.mask.film_positions, plan.visit)
    return Preview(
        seconds=seconds,
        laser_seconds=seconds["laser"],
        total_seconds=max(loop, seconds["link"], seconds["disk"]),
        limiting=_limiting(seconds, loop),
        travel=way,
        retunings=frames * int((tuning > 0).sum()),
        bytes=size,
        findings=find(plan, alines_per_second=alines / loop, bytes_=file_size, free=free_bytes, resolution=resolution),
    )


def moving_seconds(plan: ScanPlan) -> NDArray[np.float64]:
    """Time (M,) to move to each point in the order of interrogation and settle there; the first is on the spot."""
    points = plan.mask.film_positions[plan.visit]
    way = np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=1)
    return np.where(way > 0, way / plan.motion.speed + plan.motion.settling, 0.0)


def tuning_seconds(plan: ScanPlan) -> NDArray[np.float64]:
    """Time (M,) to retune to each point's wavelength in the order of interrogation; the first is tuned already."""
    if plan.wavelengths is None:
        return np.zeros(plan.mask.count)
    change = np.abs(np.diff(plan.wavelengths[plan.visit], prepend=plan.wavelengths[plan.visit[0]]))
    return np.where(change > plan.tuning.tolerance, plan.tuning.settling + change / plan.tuning.speed, 0.0)


def _limiting(seconds: dict[Part, float], loop: float) -> Part:
    """Name the part that decides: what outlasts the loop of moves and shots, else the longest within it."""
    outside: list[Part] = [part for part in ("link", "disk") if seconds[part] > loop]
    inside: list[Part] = ["laser", "mover", "tuning"]
    return max(outside or inside, key=lambda part: seconds[part])
