"""Whether the application comes for its data: when it does not, only it may resume after the lease has lapsed."""

from __future__ import annotations

SLEEP = 0.8
"""An application away for this share of the lease's time to live counts as the cause of its lapse."""


class Attention:
    """When the application was last seen.

    Parameters
    ----------
    ttl
        The lease's time to live in µs of host time.
    """

    def __init__(self, ttl: int) -> None:
        self._ttl = ttl
        self._seen = self._overslept = 0

    @property
    def lost(self) -> bool:
        """Whether the application slept and the scan has not run since."""
        return self._overslept > 0

    def reset(self, now: int) -> None:
        """Begin anew: the application has just started the scan."""
        self._seen, self._overslept = now, 0

    def seen(self, now: int, *, running: bool) -> None:
        """Note that the application is here; ``running``: the device scans, so an earlier sleep did no harm."""
        if now - self._seen > SLEEP * self._ttl:
            self._overslept = now
        elif running and now - self._overslept > 2 * self._ttl:
            self._overslept = 0
        self._seen = now
