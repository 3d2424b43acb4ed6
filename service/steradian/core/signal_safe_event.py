"""Threading event that a signal handler can set safely."""

from __future__ import annotations

import select
import socket
import threading

EXIT_INTERRUPTED = 130
"""Exit code of a command that was stopped."""


class SignalSafeEvent(threading.Event):
    """Event that can be set by a signal handler without a deadlock.

    A plain event takes a lock: a handler that interrupts a wait as it begins, or another handler that sets the event,
    would wait for itself. This one sets a flag and writes to a socket on which the waiting is done. It stays set.
    """

    def __init__(self) -> None:
        super().__init__()
        self._over = False
        self._near, self._far = socket.socketpair()
        self._near.setblocking(False)

    def is_set(self) -> bool:
        """Return whether the event is set."""
        return self._over

    def set(self) -> None:
        """Set the event, irrevocably."""
        if not self._over:
            self._over = True
            self._near.send(b"\0")

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the event is set or ``timeout`` seconds have passed; return whether it is set."""
        if not self._over:
            select.select([self._far], [], [], timeout)
        return self._over

    def clear(self) -> None:
        """Raise RuntimeError, because this event cannot be cleared."""
        raise RuntimeError("a SignalSafeEvent stays set")

    def __del__(self) -> None:
        self._near.close()
        self._far.close()
