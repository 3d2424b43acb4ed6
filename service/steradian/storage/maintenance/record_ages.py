"""Validity of ages: a wrong clock must not cause retention to delete recent data.

A computer without a clock of its own starts in 1970, one with a dead battery anywhere. Ages are trusted once the clock
has gone with the steady one, which knows no time of day, for a day.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Final

from sqlalchemy import or_, select, update
from sqlalchemy.orm import Session

from steradian.storage.db.clock import Clock
from steradian.storage.db.database import Database
from steradian.storage.db.tables import EventRow, JobRow, ScanRow

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
    """Return seconds of a monotonic clock, which includes the computer's sleep where the system supports that."""
    number = getattr(time, "CLOCK_BOOTTIME", getattr(time, "CLOCK_MONOTONIC", None))  # the latter for macOS
    return time.monotonic() if number is None else time.clock_gettime(number)


class Ages:
    """Watches the clock from look to look.

    Parameters
    ----------
    clock
        The time of day.
    steady
        Seconds of a clock that is never put right.
    """

    def __init__(self, clock: Clock, steady: Callable[[], float] = steady) -> None:
        self._clock, self._steady = clock, steady
        self._last: tuple[datetime, float] | None = None
        self._held_until = float("-inf")

    def can_be_trusted(self, database: Database) -> bool:
        """Check the clock; return whether resources may be deleted by age now.

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
        """Return the reason to distrust the clock, or None."""
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

    The last one is that of the highest number: a time ahead, of a clock that is right again, does not stay the newest.
    What this start may have made itself, by the present clock, says nothing about it.
    """
    made = ((JobRow.created, JobRow.sequence), (ScanRow.created, ScanRow.sequence), (EventRow.at, EventRow.sequence))
    with database.read() as session:
        times = [
            session.scalar(select(at).where(or_(at < now - JUMP, at > now + JUMP)).order_by(number.desc()).limit(1))
            for at, number in made
        ]
    return max((each for each in times if each is not None), default=None)


def redate(session: Session, before: datetime, now: datetime) -> None:
    """Restart the age of jobs whose end was dated by a wrong clock; their history stays unchanged.

    Parameters
    ----------
    before
        Ends after it are not looked at.
    """
    for name, ended in _wrongly_dated(session, before, now).items():
        session.execute(update(JobRow).where(JobRow.id == name).values(ended=now))
        tell_redated(f"job {name}", ended)


def tell_redated(what: str, at: datetime) -> None:
    """Log that the age of a resource is counted from now."""
    _log.warning("the date of %s, %s, comes from a wrong clock; its age counts from now on", what, _said(at))


def _wrongly_dated(session: Session, before: datetime, now: datetime) -> dict[str, datetime]:
    """Return the jobs that ended before a time, as they say, and cannot have: by identifier, when they say they ended.

    Such an end lies before :data:`EARLIEST`, or before an earlier job was asked for; one asked for in the future, by a
    clock that was ahead, shows nothing.
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
