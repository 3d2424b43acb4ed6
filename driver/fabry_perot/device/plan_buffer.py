"""Buffer for a sliding window of plan points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fabry_perot.wire.messages import POINT


class PlanBuffer:
    """Buffer of the present plan's points; a plan longer than the memory is uploaded while scanning.

    Parameters
    ----------
    capacity
        Points it holds at a time.
    """

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.reset(0, 0)

    def reset(self, plan: int, length: int, start: int = 0) -> None:
        """Discard all points and expect those of ``plan``, ``length`` in all, from index ``start``."""
        self.plan, self.length = plan, length
        self.position = self.expected = start
        self._points = np.zeros(min(self.capacity, max(length, 1)), POINT)

    @property
    def window_end(self) -> int:
        """Index of the first point that is not accepted yet."""
        return min(self.length, self.position + self.capacity)

    @property
    def loaded(self) -> bool:
        """Whether a scan can start: all points are stored, or as many as fit."""
        return self.length > 0 and self.expected >= self.window_end

    def accept(self, first: int, points: NDArray[np.void]) -> NDArray[np.void]:
        """Store points from index ``first`` and return the newly stored part.

        A gap stores nothing; what is already here, or beyond the limit, is left out.
        """
        start, stop = max(first, self.expected), min(first + len(points), self.window_end)
        if first > self.expected or stop <= start:
            return points[:0]
        new = points[start - first : stop - first]
        self._points[np.arange(start, stop) % len(self._points)] = new
        self.expected = stop
        return new

    def points(self, first: int, count: int) -> NDArray[np.void]:
        """Return ``count`` stored points from index ``first``, which is not before the plan's position."""
        points: NDArray[np.void] = self._points[np.arange(first, first + count) % len(self._points)]
        return points
