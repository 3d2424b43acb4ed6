"""Named locks bound to a PostgreSQL session; used for ownership and liveness.

The server ends a session that has asked nothing for ten seconds of its own clock: that of a host without power or
network, and that of a process that is stopped. Neither side waits for ever: who holds a lock asks with a deadline.
"""

from __future__ import annotations

import hashlib
import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import Enum
from typing import Final, LiteralString

import psycopg

TIMEOUTS: Final[dict[str, int]] = {
    "connect_timeout": 5,
    "keepalives_idle": 5,
    "keepalives_interval": 1,
    "keepalives_count": 3,
    "tcp_user_timeout": 8000,
}
"""How soon the client's side of a connection to a host that is gone fails (s, s, s, probes, ms)."""
LOCK_LEASE: Final = "-c idle_session_timeout=10s -c tcp_keepalives_idle=5 -c tcp_keepalives_interval=1"
LOCK_CLASS: Final = (
    "SELECT EXISTS (SELECT FROM pg_locks WHERE locktype = 'advisory' AND granted AND pid = %s"
    " AND (classid::bigint << 32) | objid::bigint = %s)"
)
"""Whether the server's process of a session has a lock."""
QUERY_TIMEOUT: Final = 5.0
"""Seconds for which an answer is waited for."""


class LockState(Enum):
    """State of an advisory lock."""

    HELD = "held"
    TAKEN = "taken"
    UNREACHABLE = "unreachable"


class AdvisoryLock:
    """A named lock that lasts as long as one session.

    Parameters
    ----------
    url
        Of the database, as libpq takes it.
    name
        What is locked.
    shared
        Whether others may share it, as long as nobody has it alone.
    """

    def __init__(self, url: str, name: str, *, shared: bool = False) -> None:
        self._url, self.name, self._shared = url, name, shared
        self._session: psycopg.Connection[tuple[bool]] | None = None
        self._held_by = 0

    def ensure_held(self) -> LockState:
        """Reacquire the lock over a new session if needed."""
        try:
            if self._session is not None:
                _ask(self._session, "SELECT 1")
                return LockState.HELD
            session = psycopg.connect(self._url, autocommit=True, options=LOCK_LEASE, **TIMEOUTS)  # type: ignore[arg-type]
            if not _try(session, self.name, shared=self._shared):
                # A server that has not heard yet that the session before was cut keeps the lock for that one.
                own = _ask(session, LOCK_CLASS, self._held_by, _key(self.name))
                session.close()
                return LockState.UNREACHABLE if own else LockState.TAKEN
        except psycopg.Error:
            self.release()
            return LockState.UNREACHABLE
        self._session, self._held_by = session, session.info.backend_pid
        return LockState.HELD

    def hold(self, seconds: float) -> LockState:
        """Make sure that the lock is held; where it is found taken, try for a while: some borrow it for a moment."""
        hold = self.ensure_held()
        return self.acquire(seconds) if hold is LockState.TAKEN else hold

    def acquire(self, seconds: float) -> LockState:
        """Try for a while to get the lock."""
        deadline = time.monotonic() + seconds
        while (hold := self.ensure_held()) is not LockState.HELD and time.monotonic() < deadline:
            time.sleep(0.2)
        return hold

    @contextmanager
    def try_briefly(self, other: str) -> Iterator[bool]:
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
                    _ask(session, "SELECT pg_advisory_unlock(%s)", _key(other))

    def release(self) -> None:
        """Release the lock and close its session."""
        if self._session is not None:
            with suppress(psycopg.Error):
                self._session.close()
            self._session = None


def _try(session: psycopg.Connection[tuple[bool]], name: str, *, shared: bool = False) -> bool:
    how: LiteralString = "SELECT pg_try_advisory_lock_shared(%s)" if shared else "SELECT pg_try_advisory_lock(%s)"
    return _ask(session, how, _key(name))


def _ask(session: psycopg.Connection[tuple[bool]], question: LiteralString, *values: int) -> bool:
    """Ask the server; when it does not answer in time the connection is cut, and that is an error of psycopg's."""
    own = socket.socket(fileno=os.dup(session.fileno()))
    cut = threading.Timer(QUERY_TIMEOUT, _cut, [own])
    cut.daemon = True
    cut.start()
    try:
        row = session.execute(question, values or None).fetchone()
    finally:
        cut.cancel()
        own.close()
    return bool(row and row[0])


def _cut(connection: socket.socket) -> None:
    with suppress(OSError):  # it has just answered
        connection.shutdown(socket.SHUT_RDWR)


def _key(name: str) -> int:
    return int.from_bytes(hashlib.sha256(f"steradian:{name}".encode()).digest()[:8], signed=True)
