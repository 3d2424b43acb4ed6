"""Upload of a plan by absolute index, within the device's credit."""

from __future__ import annotations

from fabry_perot.host.plan import WirePlan
from fabry_perot.wire.messages import PlanStatus

MAX_LOOKAHEAD = 4
"""PLAN_DATA frames on the way before the device confirmed any."""


class Uploader:
    """Upload of one plan's points, restarted from the confirmed index when progress stalls.

    Parameters
    ----------
    plan
        What to upload.
    payload
        Largest payload of the line, in bytes.
    period
        Without progress for so many µs the upload goes back to the confirmed index.
    start
        First point to upload; the first that the device will fire.
    """

    def __init__(self, plan: WirePlan, payload: int, period: int, start: int = 0) -> None:
        self.plan = plan
        self.start = self.confirmed = start
        self.refused = False
        self._payload, self._period = payload, period
        self._next = self._limit = start
        self._moved = 0

    @property
    def done(self) -> bool:
        """Whether the device has confirmed every point."""
        return self.confirmed >= self.plan.length

    def receive(self, status: PlanStatus, now: int) -> None:
        """Process the device's PLAN_STATUS."""
        if status.plan != self.plan.uid:
            return
        self.refused |= bool(status.retransmit & 2)
        self._limit = max(self._limit, min(status.limit, self.plan.length))
        if status.expected > self.confirmed:
            self.confirmed, self._moved = status.expected, now
            self._next = max(self._next, self.confirmed)

    def due(self, now: int) -> list[bytes]:
        """Return PLAN_DATA payloads to send now."""
        if self.done or self.refused:
            return []
        if self._next > self.confirmed and now - self._moved >= self._period:
            self._next, self._moved = self.confirmed, now
        payloads = []
        per_frame = (self._payload - 10) // 16
        while self._next < min(self._limit, self.confirmed + MAX_LOOKAHEAD * per_frame):
            if self._next == self.confirmed:
                self._moved = now
            payload = self.plan.data(self._next, self._limit, self._payload)
            self._next += (len(payload) - 10) // 16
            payloads.append(payload)
        return payloads
