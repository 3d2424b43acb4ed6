"""Watchdog: detects running processes that no longer respond."""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Sequence
from contextlib import suppress

from steradian.runtime.heartbeat import STALE_AFTER, is_alive
from steradian.runtime.managed_process import ManagedProcess
from steradian.storage.data_dir.layout import DataDirectory

CHECK_INTERVAL = 1.0
"""Seconds between two questions to the API."""
HUNG_TIMEOUT = 15.0
"""Seconds without an answer after which the API is replaced: longer than a busy machine keeps it from answering."""
STARTUP_TIMEOUT = 60.0
"""Seconds that it gets to answer at all."""
_log = logging.getLogger(__name__)


class Watchdog:
    """Watchdog of the service's processes: polls the API and the heartbeats, and logs changes.

    Parameters
    ----------
    data
        Data directory with the heartbeat files.
    url
        URL of the API's health check.
    stop
        Event set when the service ends.
    """

    def __init__(self, data: DataDirectory, url: str, stop: threading.Event) -> None:
        self._data, self._url, self._stop = data, url, stop
        self._answered = time.monotonic()
        self._silent: set[str] = set()
        threading.Thread(target=self._ask, name="watch", daemon=True).start()

    def check(self, children: Sequence[ManagedProcess], now: float) -> None:
        """Log processes that became silent or recovered; kill an unresponsive API, so that it is restarted."""
        for child in children:
            if child.process is None or now - child.started < HUNG_TIMEOUT:
                self._silent.discard(child.name)
                continue
            silence = now - max(self._answered, child.started) if child.name == "api" else self._since(child.name)
            self._note(child.name, is_silent=silence > STALE_AFTER)
            has_begun = self._answered > child.started or now - child.started > STARTUP_TIMEOUT
            if child.name == "api" and silence > HUNG_TIMEOUT and has_begun:
                _log.error("api has not answered for %.0f s and is replaced", silence)
                with suppress(ProcessLookupError):
                    os.killpg(child.process.pid, signal.SIGKILL)
                child.process.wait()

    def _since(self, name: str) -> float:
        return 0.0 if is_alive(self._data.heartbeat(name), time.time()) else STALE_AFTER + CHECK_INTERVAL

    def _note(self, name: str, *, is_silent: bool) -> None:
        if is_silent and name not in self._silent:
            self._silent.add(name)
            _log.error("%s runs but has shown no sign of life for %g s", name, STALE_AFTER)
        elif not is_silent and name in self._silent:
            self._silent.discard(name)
            _log.warning("%s shows signs of life again", name)

    def _ask(self) -> None:
        while not self._stop.wait(CHECK_INTERVAL):
            if responds(self._url, timeout=HUNG_TIMEOUT):
                self._answered = time.monotonic()


def responds(url: str, timeout: float = 1.0) -> bool:
    """Return whether a URL answers with status 200."""
    try:
        with urllib.request.urlopen(url, timeout=timeout) as answer:  # noqa: S310 - our own address
            return bool(answer.status == 200)
    except (urllib.error.URLError, OSError):
        return False
