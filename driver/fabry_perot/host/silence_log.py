"""Log messages about silence of the scanner, with rate limiting and without false alarms of a busy computer."""

from __future__ import annotations

import logging
from typing import Final

_log = logging.getLogger("fabry_perot.host.io_pump")
TOLD_AFTER: Final = 1_000_000
"""Shortest silence that is logged, in µs: a scan goes on after shorter ones as if nothing had been."""
LOOK: Final = 100_000
"""A look at the line counts for no longer, in µs: before it this program did not run, and nothing could be heard."""
QUIET: Final = 60_000_000
"""Time after a logged silence in which further ones are only counted, in µs."""


class SilenceLog:
    """Logger of silent periods of one line."""

    def __init__(self) -> None:
        self._looked: int | None = None
        self._listened = 0
        self._since: int | None = None
        """Time at which the scanner was heard before the silence that is logged now, in µs."""
        self._told_at = -QUIET
        self._untold, self._longest, self._is_counted = 0, 0, False

    def note(self, now: int, heard_at: int, shortest: int) -> None:
        """Record the time at which the scanner was last heard; log start and end of a long silence.

        Parameters
        ----------
        now
            Time in µs.
        heard_at
            Time at which the scanner was heard last, in µs.
        shortest
            Silence from which on the host asks for the scanner, in µs; a shorter one is not logged either.
        """
        if self._looked is None or heard_at > self._looked or heard_at >= now:
            self._listened = 0
            self._end(heard_at)
        else:
            self._listened += min(now - self._looked, LOOK)
        self._looked = now
        if self._listened > max(TOLD_AFTER, shortest) and self._since is None and not self._is_counted:
            self._begin(now, heard_at)
        if self._is_counted:
            self._longest = max(self._longest, now - heard_at)

    def _begin(self, now: int, heard_at: int) -> None:
        if now - self._told_at < QUIET:
            self._untold, self._is_counted = self._untold + 1, True
            return
        more = f"; {self._untold} times before, up to {self._longest * 1e-6:.1f} s" if self._untold else ""
        _log.warning("the scanner is silent: nothing was received from it for %.1f s%s", (now - heard_at) * 1e-6, more)
        self._since, self._told_at, self._untold, self._longest = heard_at, now, 0, 0

    def _end(self, heard_at: int) -> None:
        self._is_counted = False
        if self._since is not None:
            _log.warning("the scanner is received again after %.1f s", (heard_at - self._since) * 1e-6)
            self._since = None
