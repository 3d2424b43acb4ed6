"""Token-bucket rate limiter per caller."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from steradian.core.exceptions import SteradianError

MAX_CALLERS = 10_000
"""Callers that are kept in mind; the one that was away for the longest is forgotten first."""


class RateLimitExceeded(SteradianError):
    """Error: the caller exceeds its rate limit; ``retry_after`` is the waiting time in seconds."""

    code = "too-many-requests"

    def __init__(self, seconds: float) -> None:
        self.retry_after = max(1, math.ceil(seconds))
        super().__init__(f"too many requests; try again in {self.retry_after} s")


class RateLimiter:
    """Token-bucket rate limiter with one bucket per caller; not thread-safe.

    Parameters
    ----------
    per_second
        Rate at which a bucket is refilled, in tokens per second.
    at_once
        Capacity of a bucket: the largest burst.
    """

    def __init__(self, per_second: float, at_once: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._per_second, self._at_once, self._clock = per_second, at_once, clock
        self._buckets: dict[str, tuple[float, float]] = {}

    def acquire(self, caller: str, cost: float = 1.0) -> None:
        """Take tokens from the caller's bucket for a request; raises :class:`RateLimitExceeded` if too few are left."""
        level = self._level(caller)
        if level < cost:
            raise RateLimitExceeded((cost - level) / self._per_second)
        self._buckets.pop(caller, None)
        self._buckets[caller] = (level - cost, self._clock())
        if len(self._buckets) > MAX_CALLERS:
            del self._buckets[next(iter(self._buckets))]

    def is_exhausted(self, caller: str) -> bool:
        """Return whether the caller's next request would exceed the rate limit."""
        return self._level(caller) < 1.0

    def _level(self, caller: str) -> float:
        level, when = self._buckets.get(caller, (self._at_once, 0.0))
        return min(self._at_once, level + (self._clock() - when) * self._per_second)
