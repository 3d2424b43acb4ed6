"""Session handshake of the host: HELLO with repetitions, timeout, and detection of other protocol versions."""

from __future__ import annotations

import secrets

from fabry_perot.errors import LinkError, ProtocolMismatch, ResponseTimeout
from fabry_perot.host.diagnosis import LineFault
from fabry_perot.host.timing import HostTiming
from fabry_perot.host.traffic import Traffic
from fabry_perot.wire.constants import PROTOCOL

ANY_VERSION = (1, 255)
"""Versions of a HELLO that asks which one the device speaks."""
PROBES = 4
"""Such HELLOs, at most."""
_UNCHANGED = bytes(set(range(1, 256)) - set(b"\r\n\x11\x13"))
MOVING = 1_000_000
"""A connection that made progress within so many µs is not given up yet."""


def new_nonce() -> int:
    """Return a random nonce that adds no XON, XOFF, CR or LF to HELLO, because some lines alter these bytes.

    So most HELLOs get through a line that is almost right, and the answer tells what is wrong. The zero keeps the
    code of the stuffing from being LF.
    """
    first, third, fourth = (secrets.choice(_UNCHANGED) for _ in range(3))
    return int.from_bytes(bytes([first, 0, third, fourth]), "little")


class Handshake:
    """State of the session handshake; times are of the host, in µs.

    Parameters
    ----------
    timing
        Time limits.
    traffic
        What was received.
    """

    def __init__(self, timing: HostTiming, traffic: Traffic) -> None:
        self._timing, self._traffic = timing, traffic
        self.versions = (PROTOCOL, PROTOCOL)
        self.done = False
        """Whether the device was ready once: what happens later is no greeting any more."""
        self._since = traffic.mark(0)
        self._due = self._tries = self._moved = 0

    def begin(self, now: int) -> None:
        """Start sending HELLO."""
        self._since = self._traffic.mark(now)
        self._due, self._tries, self._moved = now, 0, now

    def progress(self, now: int) -> None:
        """Record the time of an answer of the device, which extends the handshake's timeout."""
        self._moved = now

    def due(self, now: int, *, counted: bool) -> bool:
        """Return whether a HELLO must be sent now.

        Parameters
        ----------
        now
            The present time.
        counted
            Whether the tries are limited.

        Raises
        ------
        LinkError
            All tries were in vain.
        """
        if now < self._due:
            return False
        if counted and self._tries >= self._timing.hello_tries:
            raise self._silence(now)
        self._tries += 1
        self._due = now + self._timing.hello_period
        return True

    def overdue(self, now: int) -> LinkError | None:
        """Return an error if the device answered but its capabilities or STATUS do not arrive in time."""
        if now - self._since.time < self._timing.connect or now - self._moved < MOVING:
            return None
        return ResponseTimeout(f"the scanner answers only in part: {self._traffic.explain(self._since, now)}")

    def mismatch(self, version: int) -> ProtocolMismatch | None:
        """Return the error of a device that answers HELLO with another protocol version.

        Version 0 says that the device has none of those asked for: then ``None`` is returned once, and HELLO asks for
        any, so that the device names its own.
        """
        if version == 0 and self.versions != ANY_VERSION:
            self.versions = ANY_VERSION
            self._due, self._tries = 0, max(0, self._timing.hello_tries - PROBES)
            return None
        return ProtocolMismatch(_other(version))

    def _silence(self, now: int) -> LinkError:
        if self.versions == ANY_VERSION:
            return ProtocolMismatch(_other(0))
        told = f"no scanner answered after {self._tries} tries: {self._traffic.explain(self._since, now)}"
        other = self._traffic.trouble(self._since) is LineFault.OTHER_FRAMES
        return ProtocolMismatch(told) if other else ResponseTimeout(told)


def _other(version: int) -> str:
    if not version:
        return f"the scanner does not speak protocol version {PROTOCOL}, this driver's, and does not state its own"
    age = "its firmware is older than this driver" if version < PROTOCOL else "this driver is older than its firmware"
    return f"the scanner speaks protocol version {version}, this driver version {PROTOCOL}: {age}"
