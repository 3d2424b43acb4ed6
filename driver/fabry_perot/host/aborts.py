"""ABORT messages of a host: repetition until acknowledged, and the STATUS messages that follow."""

from __future__ import annotations

from fabry_perot.host.stop_and_status_results import is_off
from fabry_perot.wire.constants import AbortLevel
from fabry_perot.wire.messages import Abort, AbortAck, Status, pack
from fabry_perot.wire.states import LATCHED_STATES

_HALF = 1 << 31


class Aborts:
    """Emergency stops and other aborts sent by one program; only the last one is active.

    Parameters
    ----------
    number
        Number before the first one: random, since an answer to another program's confirms nothing.
    period
        Time between two repetitions, in the unit of ``now``.
    """

    def __init__(self, number: int, period: float) -> None:
        self.number = number
        """Number of the last ABORT."""
        self.after: Status | None = None
        """Last STATUS that the device sent after it had acknowledged that ABORT."""
        self.acknowledgement: AbortAck | None = None
        """Answer to the last ABORT."""
        self._period = period
        self._pending: Abort | None = None
        self._due: float = 0
        self._since = 0

    @property
    def pending(self) -> bool:
        """Whether the last ABORT is not acknowledged yet."""
        return self._pending is not None

    @property
    def was_sent(self) -> bool:
        """Whether this program has sent an ABORT, acknowledged or not."""
        return self.pending or self.acknowledgement is not None

    @property
    def is_off(self) -> bool:
        """Whether the device reported, after it acknowledged the last ABORT, that the laser is off."""
        return self.after is not None and is_off(self.after)

    def start(self, level: AbortLevel, now: float) -> int:
        """Start sending an ABORT and return its number; its level is at least that of a pending ABORT."""
        if self._pending is not None:
            level = max(level, AbortLevel(self._pending.level))
        self.number = (self.number + 1) & 0xFFFFFFFF
        self._pending, self._due = Abort(level, self.number), now
        self.acknowledgement, self.after, self._since = None, None, 0
        return self.number

    def drop(self) -> None:
        """Stop sending the ABORT, because the device has rebooted since."""
        self._pending = None

    def due(self, now: float) -> bytes | None:
        """Return the ABORT payload to send now, or ``None``."""
        if self._pending is None or now < self._due:
            return None
        self._due = now + self._period
        return pack(self._pending)

    def due_at(self) -> float | None:
        """Return the time of the next repetition; ``None`` without a pending ABORT."""
        return None if self._pending is None else self._due

    def acknowledge(self, ack: AbortAck) -> bool:
        """Process an ABORT_ACK and return whether it answers the last ABORT."""
        if self._pending is None or self._pending != (ack.level, ack.number):
            return False
        self._pending, self.acknowledgement = None, ack
        return True

    def answered(self, number: int) -> bool:
        """Return whether the device acknowledged the ABORT with this number, or a later one."""
        ack = self.acknowledgement
        return ack is not None and (ack.number - number) & 0xFFFFFFFF < _HALF

    def take(self, status: Status) -> None:
        """Process a STATUS; the first one is ignored if older than the urgent ABORT_ACK, unless both agree."""
        ack = self.acknowledgement
        if ack is None:
            return
        self._since += 1
        if self._since > 1 or status.state == ack.state or status.state in LATCHED_STATES:
            self.after = status
