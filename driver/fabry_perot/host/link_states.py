"""States of the host's side of the link."""

from __future__ import annotations

from enum import IntEnum


class HostState(IntEnum):
    """State of the host's side of the link."""

    CLOSED = 0
    HELLO = 1
    CONFIG = 2
    """Reading the capabilities."""
    CONNECTED = 3
    UPLOAD = 4
    ARMING = 5
    STREAMING = 6
    GAP_FILL = 7
    """Streaming, with A-lines known to be missing."""
    DRAINING = 8
    LOST = 9
    """No STATUS for the silence limit; the session is kept in case it comes back."""
