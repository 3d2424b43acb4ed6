"""Executor of API requests to clear the scanner's latched fault."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from steradian.core.exceptions import SteradianError
from steradian.scans.acquisition.fault_clearing import HEARD_WITHIN
from steradian.scans.acquisition.port_monitor import PortMonitor
from steradian.storage.data_dir.fault_requests import ClearAnswer, ClearFaultRequest, ClearRequest

POLL_INTERVAL = 0.2
"""Seconds between two looks for a request."""
_log = logging.getLogger(__name__)


class ClearFaultExecutor:
    """Thread that executes each API request to clear the scanner's fault once.

    Parameters
    ----------
    clearing
        Queue of the requests.
    watch
        Monitor of the scanner's port.
    """

    def __init__(self, clearing: ClearFaultRequest, watch: PortMonitor) -> None:
        self._clearing, self._watch = clearing, watch
        self._over = threading.Event()
        self._done = ""

    @contextmanager
    def working(self) -> Iterator[None]:
        """Run the thread that polls for fault-clearing requests until the block ends."""
        thread = threading.Thread(target=self._run, name="fault-clearing", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._over.set()
            thread.join(HEARD_WITHIN)

    def _run(self) -> None:
        while not self._over.wait(POLL_INTERVAL):
            try:
                request = self._clearing.asked()
                if request is not None and request.number != self._done:
                    self._done = request.number
                    if self._clearing.answered(request.number) is None:
                        self._clearing.answer(self._carry_out(request))
            except Exception:  # whatever it was, the next request comes
                _log.exception("a request to clear the scanner's fault cannot be carried out")

    def _carry_out(self, request: ClearRequest) -> ClearAnswer:
        try:
            fault = self._watch.clear_fault(lambda: request.has_time)
        except SteradianError as error:
            _log.warning("%s requested to clear the scanner's fault: %s", request.who, error)
            return ClearAnswer(request.number, code=error.code, message=str(error)[:500])
        if fault:
            _log.warning("%s has cleared the scanner's fault %s", request.who, fault)
        return ClearAnswer(request.number, fault)
