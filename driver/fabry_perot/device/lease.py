"""Laser lease: time-limited permission to emit."""

from __future__ import annotations


class LaserLease:
    """Laser lease: time-limited permission to emit; a renewal extends it to ``echo + min(TTL, cap)`` of device time.

    The host echoes a time the device itself sent, so bytes that waited in a buffer carry their age with them and
    cannot keep the laser on; a watchdog on arrival times could not tell. A time the device has not reached yet it
    cannot have sent: such an echo proves nothing and is counted.

    Parameters
    ----------
    cap
        Longest time to live granted, in µs of device time.
    """

    def __init__(self, cap: int) -> None:
        self.cap = cap
        self.until = 0
        self.impossible = 0
        """Renewals with an echo of the future."""
        self._not_before = 0

    def renew(self, echo: int, ttl: int, now: int) -> bool:
        """Extend the lease by a time echo and TTL; return whether the laser may emit now.

        An echo from before the present session is ignored, and an older renewal that arrives late shortens nothing.
        """
        if echo > now:
            self.impossible += 1
        elif echo >= self._not_before:
            self.until = max(self.until, echo + min(ttl, self.cap))
        return self.permits(now)

    def permits(self, now: int) -> bool:
        """Return whether the laser may emit at ``now``."""
        return now < self.until

    def remaining(self, now: int) -> int:
        """Return the µs until the lease expires, 0 when expired."""
        return max(0, self.until - now)

    def clear(self, now: int) -> None:
        """End the lease at ``now``; a later renewal with any time echo of this session is still valid."""
        self.until = min(self.until, now)

    def revoke(self, now: int) -> None:
        """End the lease at ``now``; renewals with an echo of an earlier time are ignored."""
        self.clear(now)
        self._not_before = now
