"""Check of the system clock, so that a wrong clock does not make retention delete recent data.

A computer without a clock of its own starts in 1970, one with a dead battery anywhere. Ages are
trusted once the clock has gone with the steady one, which knows no time of day, for a day.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Final

from sqlalchemy import or_, select, update
from sqlalchemy.orm import Session

from steradian.storage.db.database import Database
from steradian.storage.db.tables import EventRow, JobRow, ScanRow
from steradian.storage.db.timestamps_and_ids import Clock

EARLIEST: Final = datetime(2025, 1, 1, tzinfo=UTC)
"""There was no Steradian before: what is dated earlier was dated by a wrong clock."""
JUMP: Final = timedelta(hours=1)
"""More than clocks are put right by every day; summer time moves none that counts in UTC."""
UNSEEN: Final = timedelta(days=1)
"""Without a record for so long, a start cannot tell a long pause from a clock that is ahead."""
HELD: Final = timedelta(days=1)
"""For so long nothing is deleted by its age after a sign that the clock is, or was, wrong."""
_log = logging.getLogger(__name__)


def steady() -> float:
    """Return seconds of a monotonic clock, including system sleep where supported."""
    number = getattr(time, "CLOCK_BOOTTIME", getattr(time, "CLOCK_MONOTONIC", None))  # the latter for macOS
    return time.monotonic() if number is None else time.clock_gettime(number)


class TrustedClock:
    """Check of the system clock for jumps, which suspends deletion by age when the clock is in doubt.

    Parameters
    ----------
    clock
        System clock (time of day).
    steady
        Seconds of a monotonic clock.
    """

    def __init__(self, clock: Clock, steady: Callable[[], float] = steady) -> None:
        self._clock, self._steady = clock, steady
        self._last: tuple[datetime, float] | None = None
        self._held_until = float("-inf")

    def can_be_trusted(self, database: Database) -> bool:
        """Check the system clock and return whether resources may be deleted by age now.

        The first failed check of a kind is logged.
        """
        now, seconds = self._clock(), self._steady()
        doubt = self._doubt(now, seconds, database)
        self._last = now, seconds
        if doubt is not None:
            self._held_until = seconds + HELD.total_seconds()
            _log.warning("%s; nothing is deleted by its age for %g h", doubt, HELD / timedelta(hours=1))
        return seconds >= self._held_until

    def _doubt(self, now: datetime, seconds: float, database: Database) -> str | None:
        """Return the reason to distrust the system clock (early date or jump), or None."""
        if now < EARLIEST:
            return f"the clock shows {_said(now)}"
        if self._last is not None:
            before, then = self._last
            jump = (now - before) - timedelta(seconds=seconds - then)
            way = "ahead" if jump > timedelta(0) else "back"
            return f"the clock jumped {way} by {abs(jump)}, to {_said(now)}" if abs(jump) > JUMP else None
        newest = newest_record(database, now)
        if newest is not None and newest - now > JUMP:
            return f"the clock shows {_said(now)}, before the newest record of {_said(newest)}"
        if newest is not None and now - newest > UNSEEN:
            return f"the newest record is of {_said(newest)}, the clock shows {_said(now)}"
        return None


def newest_record(database: Database, now: datetime) -> datetime | None:
    """Return the time of the newest job, scan or event in the database; ``None`` without any.

    The newest record is the one with the highest sequence number, because times may come from a wrong clock. Records
    near the present time are ignored, because this process may have written them.
    """
    made = ((JobRow.created, JobRow.sequence), (ScanRow.created, ScanRow.sequence), (EventRow.at, EventRow.sequence))
    with database.read() as session:
        times = [
            session.scalar(select(at).where(or_(at < now - JUMP, at > now + JUMP)).order_by(number.desc()).limit(1))
            for at, number in made
        ]
    return max((each for each in times if each is not None), default=None)


def redate(session: Session, before: datetime, now: datetime) -> None:
    """Set the end of jobs that a wrong clock dated to ``now``, which restarts their age.

    Parameters
    ----------
    before
        Jobs that ended later are ignored.
    """
    for name, ended in _wrongly_dated(session, before, now).items():
        session.execute(update(JobRow).where(JobRow.id == name).values(ended=now))
        tell_redated(f"job {name}", ended)


def tell_redated(what: str, at: datetime) -> None:
    """Log a warning that the age of a resource is counted from now."""
    _log.warning("the date of %s, %s, comes from a wrong clock; its age counts from now on", what, _said(at))


def _wrongly_dated(session: Session, before: datetime, now: datetime) -> dict[str, datetime]:
    """Return the jobs whose recorded end is impossible, because a wrong clock dated it, with that end.

    Such an end lies before :data:`EARLIEST`, or before the creation of a job with a smaller sequence number; jobs with
    a creation time in the future are ignored.
    """
    old = select(JobRow.sequence, JobRow.id, JobRow.ended).where(JobRow.ended < before)
    ends = {row.sequence: (row.id, row.ended) for row in session.execute(old)}
    if not ends:
        return {}
    wrong, latest = {}, EARLIEST
    asked = select(JobRow.sequence, JobRow.created).where(JobRow.sequence <= max(ends), JobRow.created <= now)
    for number, created in session.execute(asked.order_by(JobRow.sequence)):
        name, ended = ends.get(number, ("", latest))
        if ended < latest:
            wrong[name] = ended
        latest = max(latest, created)
    return wrong


def _said(at: datetime) -> str:
    return at.isoformat(timespec="seconds")
