"""Singleton locks: one service per database, one node per scanner."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from steradian.core.exceptions import Conflict, InvalidInput
from steradian.core.settings import Settings

if TYPE_CHECKING:
    from steradian.storage.db.advisory_locks import AdvisoryLock

RENEW_INTERVAL = 2.0
"""Seconds between proofs that what is owned still is."""
ACQUIRE_TIMEOUT = 10.0
"""Seconds for which an earlier owner, which is just ending, is waited for."""


@contextmanager
def hold_database_lock(settings: Settings) -> Iterator[Callable[[], None]]:
    """Hold the service's advisory lock on a PostgreSQL database; yields a function that raises if the lock is lost.

    In a service of several nodes the lock is shared.
    """
    if settings.database_url is None:
        yield lambda: None
        return
    from steradian.storage.db.advisory_locks import AdvisoryLock

    lock = AdvisoryLock(settings.database_url, "service", shared=settings.role != "service")
    with _hold(lock, "another service runs on this database; stop it or choose another database") as check:
        yield check


@contextmanager
def hold_scanner_lock(settings: Settings) -> Iterator[Callable[[], None]]:
    """Hold a scanner's advisory lock in a multi-node service; yields a function that raises if the lock is lost."""
    if settings.database_url is None or settings.role != "acquisition":
        yield lambda: None
        return
    name = settings.scanner_id
    lock = lock_of_scanner(settings.database_url, name)
    with _hold(lock, f"another node has {name}; stop it or name this one otherwise (STERADIAN_SCANNER_ID)") as check:
        yield check


def lock_of_scanner(database_url: str, name: str) -> AdvisoryLock:
    """Return the advisory lock that a scanner's node holds during its lifetime."""
    from steradian.storage.db.advisory_locks import AdvisoryLock

    return AdvisoryLock(database_url, f"scanner {name}")


@contextmanager
def _hold(lock: AdvisoryLock, refusal: str) -> Iterator[Callable[[], None]]:
    from steradian.storage.db.advisory_locks import LockState

    over, taken = threading.Event(), threading.Event()

    def stay() -> None:  # a thread's work: a connection that is cut off answers late, and the children are tended
        while not over.wait(RENEW_INTERVAL):
            if lock.hold(RENEW_INTERVAL) is LockState.TAKEN:
                taken.set()

    def check() -> None:
        if taken.is_set():
            raise Conflict(f"taken over meanwhile: {refusal}")

    hold = lock.acquire(seconds=ACQUIRE_TIMEOUT)
    if hold is LockState.UNREACHABLE:
        raise InvalidInput("STERADIAN_DATABASE_URL", "set", "a PostgreSQL database that answers")
    if hold is LockState.TAKEN:
        raise Conflict(refusal)
    keeper = threading.Thread(target=stay, daemon=True)
    keeper.start()
    try:
        yield check
    finally:
        over.set()
        keeper.join()
        lock.release()
