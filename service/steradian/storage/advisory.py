"""Advisory locks of PostgreSQL that say who is alive: held by a session, gone with it.

The keepalives are set on the server's side of the session, so that a host that loses its power is noticed after
seven seconds and not after hours.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import Enum

import psycopg

KEEPALIVE = "-c tcp_keepalives_idle=5 -c tcp_keepalives_interval=1 -c tcp_keepalives_count=2"
CONNECT_TIMEOUT_S = 5


class Hold(Enum):
    """How a lock stands."""

    HELD = "held"
    TAKEN = "taken"
    UNREACHABLE = "unreachable"


class SessionLock:
    """A named lock that lasts as long as one session.

    Parameters
    ----------
    url
        Of the database, as libpq takes it.
    name
        What is locked.
    """

    def __init__(self, url: str, name: str) -> None:
        self._url, self.name = url, name
        self._session: psycopg.Connection[tuple[bool]] | None = None

    def renew(self) -> Hold:
        """Make sure that the lock is held, over a new session if need be."""
        try:
            if self._session is not None:
                self._session.execute("SELECT 1")
                return Hold.HELD
            session = psycopg.connect(self._url, autocommit=True, options=KEEPALIVE, connect_timeout=CONNECT_TIMEOUT_S)
        except psycopg.Error:
            self.release()
            return Hold.UNREACHABLE
        if not _try(session, self.name):
            session.close()
            return Hold.TAKEN
        self._session = session
        return Hold.HELD

    def acquire(self, seconds: float) -> Hold:
        """Try for a while to get the lock."""
        deadline = time.monotonic() + seconds
        while (hold := self.renew()) is not Hold.HELD and time.monotonic() < deadline:
            time.sleep(0.2)
        return hold

    @contextmanager
    def borrowed(self, other: str) -> Iterator[bool]:
        """Hold another name's lock for a moment; yields whether it was free."""
        session = self._session
        try:
            free = session is not None and _try(session, other)
        except psycopg.Error:
            session, free = None, False
        try:
            yield free
        finally:
            if free and session is not None:
                with suppress(psycopg.Error):
                    session.execute("SELECT pg_advisory_unlock(%s)", [_key(other)])

    def release(self) -> None:
        """Let go; the session ends."""
        if self._session is not None:
            with suppress(psycopg.Error):
                self._session.close()
            self._session = None


def _try(session: psycopg.Connection[tuple[bool]], name: str) -> bool:
    row = session.execute("SELECT pg_try_advisory_lock(%s)", [_key(name)]).fetchone()
    return bool(row and row[0])


def _key(name: str) -> int:
    return int.from_bytes(hashlib.sha256(f"steradian:{name}".encode()).digest()[:8], signed=True)
