"""Clock of tests."""

from __future__ import annotations


class VirtualClock:
    """Clock for tests; its time changes only through :meth:`advance`.

    Parameters
    ----------
    start
        First time in µs.
    """

    def __init__(self, start: int = 0) -> None:
        self._now = start

    def now(self) -> int:
        """Return the time last set, in µs."""
        return self._now

    def advance(self, microseconds: int) -> int:
        """Advance the time by ``microseconds`` (≥ 0) and return the new time."""
        if microseconds < 0:
            raise ValueError(f"the clock cannot run backwards (requested: {microseconds} µs)")
        self._now += microseconds
        return self._now
