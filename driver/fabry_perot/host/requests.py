"""Pending requests: retransmission, and matching of replies."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from fabry_perot.errors import RequestRejected, ResponseTimeout, ScannerError
from fabry_perot.host.timing import HostTiming
from fabry_perot.host.traffic import Mark, Traffic
from fabry_perot.wire.constants import Operation, Result
from fabry_perot.wire.messages import REQUEST_HEAD, pack_body
from fabry_perot.wire.states import DeviceState

_LONG_REQUESTS = {Operation.TUNE_SCAN: 20}
"""Operations that take their time are asked for so many times as often."""


@dataclass(slots=True, eq=False)
class PendingRequest:
    """Pending request and, after the reply, its outcome."""

    number: int
    operation: Operation
    payload: bytes
    due: int
    since: Mark
    tries: int = 0
    answer: dict[str, Any] = field(default_factory=dict)
    error: ScannerError | None = None
    done: bool = False

    def result(self) -> dict[str, Any]:
        """Return the reply's parameters; raises the error of device or link."""
        if self.error is not None:
            raise self.error
        return self.answer


class RequestTracker:
    """Tracker of all pending requests of one session.

    Parameters
    ----------
    timing
        Time limits.
    traffic
        What was received.
    """

    def __init__(self, timing: HostTiming, traffic: Traffic) -> None:
        self._timing, self._traffic = timing, traffic
        self._open: dict[int, PendingRequest] = {}
        self._number = 0

    def start(self, operation: Operation, body: dict[str, Any], now: int) -> PendingRequest:
        """Register a request; :meth:`due_payloads` returns its payload."""
        self._number = self._number % 0xFFFF + 1
        payload = REQUEST_HEAD.pack(self._number, operation) + (pack_body(body) if body else b"")
        call = PendingRequest(self._number, operation, payload, now, self._traffic.mark(now))
        self._open[call.number] = call
        return call

    def due_payloads(self, now: int) -> list[tuple[bytes, bool]]:
        """Return payloads to send now, each with whether it is a repetition; requests fail after too many tries."""
        payloads: list[tuple[bytes, bool]] = []
        if not self._open:
            return payloads
        for call in list(self._open.values()):
            if now < call.due:
                continue
            if call.tries >= self._timing.request_tries * _LONG_REQUESTS.get(call.operation, 1):
                why = self._traffic.explain(call.since, now)
                self._close(call, ResponseTimeout(f"no reply to {call.operation.name} after {call.tries} tries: {why}"))
                continue
            payloads.append((call.payload, call.tries > 0))
            call.tries += 1
            call.due = now + self._timing.request_period
        return payloads

    def answer(self, number: int, result: int, state: DeviceState, body: dict[str, Any]) -> PendingRequest | None:
        """Match a reply to its request and return that request; ``None`` for an unexpected reply."""
        call = self._open.get(number)
        if call is None:
            return None
        call.answer = body
        word = _result_text(result) + (f" ({body['field']})" if "field" in body else "")
        self._close(call, None if result == Result.OK else RequestRejected(call.operation.name, word, state.name))
        return call

    def fail(self, error: ScannerError) -> None:
        """End all pending requests with ``error``."""
        for call in list(self._open.values()):
            self._close(call, error)

    def _close(self, call: PendingRequest, error: ScannerError | None) -> None:
        call.error, call.done = error, True
        del self._open[call.number]


def _result_text(result: int) -> str:
    try:
        return Result(result).name.lower().replace("_", "-")
    except ValueError:
        return f"reason {result}"
