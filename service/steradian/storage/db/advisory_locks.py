"""PostgreSQL advisory locks, held by a session; used for exclusive ownership and liveness of processes.

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
from typing import TYPE_CHECKING, Final, LiteralString

if TYPE_CHECKING:
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
    """State of an advisory lock: held, taken by another session, or server unreachable."""

    HELD = "held"
    TAKEN = "taken"
    UNREACHABLE = "unreachable"


class AdvisoryLock:
    """PostgreSQL advisory lock with a name, held as long as its session lives.

    Parameters
    ----------
    url
        URL of the database, in the form of libpq.
    name
        Name of the lock.
    shared
        Whether the lock is shared: compatible with other shared locks of the name, but not with an exclusive one.
    """

    def __init__(self, url: str, name: str, *, shared: bool = False) -> None:
        self._url, self.name, self._shared = url, name, shared
        self._session: psycopg.Connection[tuple[bool]] | None = None
        self._held_by = 0

    def ensure_held(self) -> LockState:
        """Acquire the lock unless this object holds it, reconnecting if needed, and return its state."""
        import psycopg

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
        """Renew the lock; if another session has taken it, retry for ``seconds`` seconds."""
        hold = self.ensure_held()
        return self.acquire(seconds) if hold is LockState.TAKEN else hold

    def acquire(self, seconds: float) -> LockState:
        """Retry for ``seconds`` seconds until the lock is acquired, and return its state."""
        deadline = time.monotonic() + seconds
        while (hold := self.ensure_held()) is not LockState.HELD and time.monotonic() < deadline:
            time.sleep(0.2)
        return hold

    @contextmanager
    def try_briefly(self, other: str) -> Iterator[bool]:
        """Acquire another name's lock until the block ends; yields whether it was free."""
        import psycopg

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
        """Release the advisory lock by closing its session."""
        if self._session is not None:
            import psycopg

            with suppress(psycopg.Error):
                self._session.close()
            self._session = None


def _try(session: psycopg.Connection[tuple[bool]], name: str, *, shared: bool = False) -> bool:
    how: LiteralString = "SELECT pg_try_advisory_lock_shared(%s)" if shared else "SELECT pg_try_advisory_lock(%s)"
    return _ask(session, how, _key(name))


def _ask(session: psycopg.Connection[tuple[bool]], question: LiteralString, *values: int) -> bool:
    """Run an SQL query for a boolean with a timeout, after which the connection is closed."""
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
