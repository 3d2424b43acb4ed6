"""Default clock (UTC) for database rows, and identifiers that sort by time (ULID)."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from typing import TypeAlias

from ulid import ULID

Clock: TypeAlias = Callable[[], datetime]


def utc_now() -> datetime:
    """Return the current time in UTC."""
    return datetime.now(UTC)


def new_id(prefix: str) -> str:
    """Return a new identifier of a prefix and a ULID, which sorts by creation time."""
    return prefix + str(ULID()).lower()
