"""Planned points without an A-line, and the largest gap in the coverage that they cause."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, degrees

import numpy as np
from numpy.typing import NDArray

from steradian.scans.recording import Recording


@dataclass(frozen=True)
class IncompleteCoverage:
    """Number of planned points without an A-line, and the largest gap that they cause.

    Attributes
    ----------
    count, planned
        Points without an A-line, and of the plan.
    first_m, last_m
        Corners of the smallest rectangle around them, in metres, an entry per axis.
    hole_m
        Diameter in metres of the largest circle around one of them with no measured point in it.
    hole_at_m
        Its centre in metres.
    hole_deg
        The angle it fills as seen from the point of interest, in degrees; ``None`` without one.
    """

    count: int
    planned: int
    first_m: tuple[float, ...]
    last_m: tuple[float, ...]
    hole_m: float
    hole_at_m: tuple[float, ...]
    hole_deg: float | None

    @property
    def share(self) -> float:
        """Fraction of planned points that have no A-line."""
        return self.count / self.planned

    def __str__(self) -> str:
        axes = zip("xy", self.first_m, self.last_m, strict=False)
        where = ", ".join(f"{axis} {1e3 * low:.2f} … {1e3 * high:.2f} mm" for axis, low, high in axes)
        at = ", ".join(f"{1e3 * value:.2f}" for value in self.hole_at_m)
        seen = "" if self.hole_deg is None else f", {self.hole_deg:.0f}° as seen from the point of interest"
        return (
            f"{self.count:,} of {self.planned:,} points ({100 * self.share:.3g} %) are not measured, within {where}; "
            f"the largest hole is {1e3 * self.hole_m:.2f} mm wide around ({at}) mm{seen}"
        )


def find_missing_points(recording: Recording) -> IncompleteCoverage | None:
    """Return the missing points of a recording relative to its plan; ``None`` if complete or if the plan is unknown."""
    absent = recording.missing
    if absent is None or not len(absent):
        return None
    from scipy.spatial import KDTree

    distances = np.asarray(KDTree(recording.positions).query(absent)[0])
    place = int(np.argmax(distances))
    radius, centre = float(distances[place]), absent[place]
    return IncompleteCoverage(
        count=len(absent),
        planned=recording.planned,
        first_m=tuple(absent.min(axis=0).tolist()),
        last_m=tuple(absent.max(axis=0).tolist()),
        hole_m=2 * radius,
        hole_at_m=tuple(centre.tolist()),
        hole_deg=None if recording.depth is None else _gap_angle(centre, radius, recording),
    )


def _gap_angle(centre: NDArray[np.float64], radius: float, recording: Recording) -> float:
    """Return the angle in degrees that a circular gap subtends at the point of interest."""
    across = centre - np.asarray(recording.offset[: len(centre)])
    distance = float(np.linalg.norm(across))
    ends = np.array([[distance - radius, recording.depth], [distance + radius, recording.depth]])
    ends /= np.linalg.norm(ends, axis=1, keepdims=True)
    return degrees(acos(min(1.0, float(ends[0] @ ends[1]))))
