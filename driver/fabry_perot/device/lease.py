"""The laser lease: permission to emit that ends by itself."""

from __future__ import annotations


class LaserLease:
    """Emission is allowed until ``echo + min(TTL, cap)`` of device time, for an ``echo`` that is not after now.

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
        """Extend the lease; return whether it permits emission now.

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
        """Return the remaining µs, 0 when expired."""
        return max(0, self.until - now)

    def clear(self, now: int) -> None:
        """End the lease at ``now``; a renewal with any echo of this session may follow."""
        self.until = min(self.until, now)

    def revoke(self, now: int) -> None:
        """End the lease at ``now``; echoes of earlier times count no more."""
        self.clear(now)
        self._not_before = now
