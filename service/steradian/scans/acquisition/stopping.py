"""Stopping rule of a running scan: its images are judged beside the scan, in another process."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Protocol

from steradian.plans import ScanPlan

INTERVAL: Final = 0.5
"""Seconds between two looks at the scan file."""
_log = logging.getLogger(__name__)


class ImageJudge(Protocol):
    """Interface of the computation that judges whether a scan has enough points."""

    def enough(self, path: Path, plan: ScanPlan) -> str:
        """Return why a scan has enough points, by the stopping rule of its plan; empty: it has not."""
        ...


@contextmanager
def stopping_monitor(path: Path, plan: ScanPlan, judge: ImageJudge | None) -> Iterator[Callable[[], str]]:
    """Context manager during which a thread judges the images of a running scan by the stopping rule of its plan.

    Parameters
    ----------
    path, plan
        Scan file and its plan.
    judge
        The computation.

    Yields
    ------
    callable
        Returns why the scan has enough points; empty while it has not, before the last stage, and without a rule.
    """
    if plan.stopping is None or plan.stages or judge is None:
        yield str
        return
    reasons, over = [""], threading.Event()

    def work() -> None:
        while not (over.wait(INTERVAL) or reasons[0]):
            try:
                reasons[0] = judge.enough(path, plan)
            except Exception as error:  # the scan then goes on to its last point
                if not over.is_set():
                    _log.warning("the stopping rule of %s is not followed: %s", path, error)
                return

    threading.Thread(target=work, name="stopping-rule", daemon=True).start()
    try:
        yield lambda: reasons[0]
    finally:
        over.set()
