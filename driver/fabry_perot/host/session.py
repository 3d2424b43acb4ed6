"""A live session: the host state machine, its pump thread, and waiting for what it reports."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable
from typing import Any

from fabry_perot.clock import Clock, RealClock
from fabry_perot.errors import LinkLost, NoAnswer
from fabry_perot.host import Host, HostTiming
from fabry_perot.host.streaming import Pump
from fabry_perot.host.transport import Transport
from fabry_perot.wire.codes import Operation

STEP = 0.05
"""Longest wait between two looks at the state, in s; also how often a waiting consumer renews the lease."""
_PATIENCE = 15.0


class Session:
    """A host talking through a transport.

    Parameters
    ----------
    transport
        The open port; closed with the session.
    clock
        Host time.
    timing
        Time limits.
    reopen, patience
        How to open a lost port anew, and for how many seconds to try.

    Raises
    ------
    NoAnswer, ProtocolMismatch, LinkLost
        No session came about; the port is released.
    """

    def __init__(
        self,
        transport: Transport,
        clock: Clock | None = None,
        timing: HostTiming | None = None,
        reopen: Callable[[], Transport] | None = None,
        patience: float = 0.0,
    ) -> None:
        self.clock = clock or RealClock()
        self.host = Host(secrets.randbits(32), timing)
        self.changed = threading.Condition()
        self._closed = False
        self._pump = Pump(transport, self.host, self.clock, self.changed, reopen, patience)
        try:
            self._pump.start()
            self.wait(lambda: self.host.capabilities is not None and self.host.status is not None, _PATIENCE)
        except BaseException:
            self._pump.stop()
            raise

    @property
    def reconnects(self) -> int:
        """How often the port was opened anew."""
        return self._pump.reconnects

    def now(self) -> int:
        """Return the host's time in µs."""
        return self.clock.now()

    def flush(self) -> None:
        """Send what the host has to say now."""
        self._pump.flush()

    def request(self, operation: Operation, **body: Any) -> dict[str, Any]:
        """Make a request and return its answer; raises what the device or the link says instead."""
        return self.call(lambda now: self.host.call(operation, now, **body))

    def call(self, start: Callable[[int], Any]) -> dict[str, Any]:
        """Start a call by ``start(now)`` and return its answer."""
        with self.changed:
            call = start(self.now())
        self.flush()
        self.wait(lambda: call.done, _PATIENCE, raise_failure=False)
        answer: dict[str, Any] = call.result()
        return answer

    def wait(self, ready: Callable[[], bool], timeout: float, *, raise_failure: bool = True) -> None:
        """Wait until ``ready()``, at most ``timeout`` s; raises NoAnswer, the host's failure, LinkLost once closed."""
        deadline = self.now() + int(timeout * 1e6)
        with self.changed:
            while not ready():
                if raise_failure and self.host.failure is not None:
                    raise self.host.failure
                if self._closed:
                    raise LinkLost("the connection was closed")
                if self.now() > deadline:
                    raise NoAnswer(f"the scanner did not get there within {timeout:g} s")
                self.changed.wait(STEP)

    def close(self) -> None:
        """End the thread and release the port; who waits elsewhere is told."""
        with self.changed:
            self._closed = True
            self.changed.notify_all()
        self._pump.stop()
