"""Failover between workers: dead workers are detected by advisory locks, and their jobs are queued again."""

from __future__ import annotations

import logging
import os
import threading
from collections import Counter
from collections.abc import Callable, Collection
from typing import Final

from steradian.core.exceptions import Conflict
from steradian.storage.db.advisory_locks import AdvisoryLock, LockState

CHECK_INTERVAL: Final = 2.0
"""Seconds between looks at the other workers' signs of life."""
MISSED_BEFORE_TAKEOVER: Final = 3
"""How often in a row a worker must be found gone: after a database's restart each needs a moment to come back."""
CLAIM_TIMEOUT: Final = 5.0
"""Seconds for which a name may still be held by a worker that is just ending."""
_log = logging.getLogger(__name__)


def claim_name(url: str, name: str) -> AdvisoryLock:
    """Acquire the advisory lock of a worker's name for the lifetime of the process.

    Raises
    ------
    Conflict
        When another worker holds it.
    """
    lock = AdvisoryLock(url, name)
    if lock.acquire(CLAIM_TIMEOUT) is not LockState.HELD:
        raise Conflict(f"another worker named {name} runs on this database; choose another name")
    return lock


def monitor_peers(
    lock: AdvisoryLock,
    stopping: threading.Event,
    pending: Callable[[], Collection[str]],
    recover: Callable[[str], object],
) -> None:
    """Renew this worker's advisory lock and requeue the jobs of dead workers, until ``stopping`` is set.

    Parameters
    ----------
    pending
        Callback that returns the names of workers with unfinished jobs.
    recover
        Callback that requeues the jobs of a worker.
    """
    missed: Counter[str] = Counter()
    while not stopping.wait(CHECK_INTERVAL):
        try:
            hold = lock.hold(CLAIM_TIMEOUT)
            if hold is LockState.TAKEN:
                _log.error("another worker took over the name %s; this one ends", lock.name)
                logging.shutdown()
                os._exit(1)  # its child ends with it
            others = set(pending()) - {lock.name} if hold is LockState.HELD else set()
            missed = Counter({name: missed[name] for name in others})
            for name in others:
                with lock.try_briefly(name) as free:
                    missed[name] = missed[name] + 1 if free else 0
                    if missed[name] >= MISSED_BEFORE_TAKEOVER:
                        _log.warning("worker %s is gone; its jobs are queued again", name)
                        recover(name)
        except Exception:
            _log.exception("the other workers cannot be monitored; retrying")
