"""Token-bucket rate limiter per caller."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from steradian.core.exceptions import SteradianError

MAX_CALLERS = 10_000
"""Callers that are kept in mind; the one that was away for the longest is forgotten first."""


class RateLimitExceeded(SteradianError):
    """The caller asks more often than it may; ``retry_after`` says in how many seconds it may again."""

    code = "too-many-requests"

    def __init__(self, seconds: float) -> None:
        self.retry_after = max(1, math.ceil(seconds))
        super().__init__(f"too many requests; try again in {self.retry_after} s")


class RateLimiter:
    """A token bucket for each caller; for one thread.

    Parameters
    ----------
    per_second
        How often, in the long run.
    at_once
        How often after a pause.
    """

    def __init__(self, per_second: float, at_once: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._per_second, self._at_once, self._clock = per_second, at_once, clock
        self._buckets: dict[str, tuple[float, float]] = {}

    def acquire(self, caller: str, cost: float = 1.0) -> None:
        """Count a request; raises :class:`RateLimitExceeded` when it is one too many."""
        level = self._level(caller)
        if level < cost:
            raise RateLimitExceeded((cost - level) / self._per_second)
        self._buckets.pop(caller, None)
        self._buckets[caller] = (level - cost, self._clock())
        if len(self._buckets) > MAX_CALLERS:
            del self._buckets[next(iter(self._buckets))]

    def is_exhausted(self, caller: str) -> bool:
        """Whether a request would be one too many."""
        return self._level(caller) < 1.0

    def _level(self, caller: str) -> float:
        level, when = self._buckets.get(caller, (self._at_once, 0.0))
        return min(self._at_once, level + (self._clock() - when) * self._per_second)
