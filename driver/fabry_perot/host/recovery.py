"""Carrying a scan over interruptions of line and device: resume what the device kept, plan again what it lost.

Like the host it is sans-I/O: :meth:`Keeper.poll` is told the time and looks at the host. It acts only on a scan
that a person started and nobody stopped: a pause, an abort, a fault or a consumer that fell asleep end its mandate
until somebody resumes. The laser is armed anew by the full sequence RELEASE, ARM, START, never by a shortcut.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from fabry_perot.codes import Operation
from fabry_perot.errors import LinkLost, ScannerError
from fabry_perot.host.core import Host
from fabry_perot.host.ledger import Ledger
from fabry_perot.host.plan import Plan
from fabry_perot.states import DeviceState, HoldCause, HostState

_FIRST_WAIT, _LONGEST_WAIT = 50_000, 1_000_000
_OURS = frozenset({HoldCause.LEASE, HoldCause.SESSION, HoldCause.NONE})
"""Causes of SAFE_HOLD that are interruptions rather than somebody's wish."""
_HALTED = frozenset({DeviceState.SAFE_HOLD, DeviceState.LINKED, DeviceState.READY, DeviceState.ARMED})


@dataclass(frozen=True, slots=True)
class Recovery:
    """How long a scan is carried over interruptions.

    Parameters
    ----------
    patience
        Seconds without an A-line after which an interruption is given up.
    restarts
        Whether to plan again what a rebooted device lost; otherwise ``DeviceRestarted`` is raised.
    """

    patience: float = 10.0
    restarts: bool = True


class Keeper:
    """Keeps one scan going.

    Parameters
    ----------
    host
        The host; told to tolerate restarts while a scan is kept.
    policy
        Limits.
    """

    def __init__(self, host: Host, policy: Recovery) -> None:
        self._host, self._policy = host, policy
        self.ledger = Ledger()
        self.resumes = self.restarts = 0
        self._plan: Plan | None = None
        self._steps: Iterator[None] | None = None
        self._answer: dict[str, Any] = {}
        self._due = self._wait = self._moved = self._complete = self._now = 0

    @property
    def engaged(self) -> bool:
        """Whether a scan is kept."""
        return self._plan is not None

    @property
    def minding(self) -> bool:
        """Whether the scan is interrupted in a way that is this keeper's business."""
        return self._plan is not None and (self._steps is not None or self._interrupted(self._plan))

    def engage(self, plan: Plan, laser_shots: int, now: int) -> None:
        """Keep ``plan`` from now on; ``laser_shots`` is what START answered."""
        host = self._host
        self._note_start(laser_shots)
        self._plan, self._steps = plan, None
        host.tolerant = self._policy.restarts
        self._moved, self._wait, self._due = now, _FIRST_WAIT, now

    def release(self) -> None:
        """Keep nothing any more: somebody stopped the scan, or it is done."""
        self._plan, self._steps = None, None
        self._host.tolerant = False

    def poll(self, now: int) -> None:
        """Notice an interruption, or take the next step out of it."""
        host, plan = self._host, self._plan
        if plan is None or host.failure is not None:
            return
        self._note_progress(now)
        if now - self._moved > self._policy.patience * 1e6 and not self._well():
            host.fail(LinkLost(f"no A-line for {self._policy.patience:g} s; the scan could not be taken up again"))
            return
        if self._steps is None and now >= self._due and self._interrupted(plan):
            self._steps = self._recover(plan)
        if self._steps is not None:
            self._advance(now)

    def _note_progress(self, now: int) -> None:
        complete = self._host.assembly.complete if self._host.assembly else 0
        if complete != self._complete or self._well():
            self._complete, self._moved = complete, now

    def _well(self) -> bool:
        host = self._host
        state = host.device_state
        alive = host.phase is not HostState.LOST and host.status is not None
        return alive and self._steps is None and state not in _HALTED

    def _advance(self, now: int) -> None:
        assert self._steps is not None  # noqa: S101
        try:
            self._now = now
            next(self._steps)
        except StopIteration:
            self._steps, self._wait = None, _FIRST_WAIT
        except ScannerError:  # refused or unanswered: look again at how things stand, a little later
            self._steps, self._due = None, now + self._wait
            self._wait = min(2 * self._wait, _LONGEST_WAIT)

    def _interrupted(self, plan: Plan) -> bool:
        host = self._host
        status, assembly, hello = host.status, host.assembly, host.hello
        if status is None or assembly is None or hello is None or host.phase in (HostState.LOST, HostState.HELLO):
            return False
        if status.boot != hello.boot or status.state != host.device_state or assembly.complete >= plan.length:
            return False
        if status.plan != plan.uid:
            return True
        return host.device_state in _HALTED and status.cause in _OURS

    def _recover(self, plan: Plan) -> Iterator[None]:
        """Bring the device back to scanning, step by step; each ``yield`` waits for the next poll."""
        host = self._host
        assert host.status is not None  # noqa: S101
        anew = host.status.plan != plan.uid
        if anew:
            yield from self._plan_again(plan)
            self.restarts += 1
        else:
            host.ack_due = True
            if host.device_state is DeviceState.SAFE_HOLD:
                yield from self._call(Operation.RELEASE)
        while host.device_state not in (DeviceState.READY, DeviceState.ARMED):
            if host.device_state is not DeviceState.LINKED:
                return  # it scans, or somebody or a fault has stopped it meanwhile
            yield
        yield from self._call(Operation.ARM)
        token = self._answer["token"]
        yield from self._call(Operation.START, token=token, **host.lease_fields())
        self._note_start(int(self._answer.get("laser_shots", 0)))
        self.resumes += not anew

    def _note_start(self, laser_shots: int) -> None:
        host = self._host
        if host.hello is not None and host.uploader is not None and host.status is not None:
            status = host.status
            self.ledger.started(host.hello.boot, host.uploader.start, laser_shots, status.shots_wasted, status.shots)

    def _plan_again(self, plan: Plan) -> Iterator[None]:
        yield from self._call(Operation.GET)
        host = self._host
        if host.assembly is not None and host.hello is not None:
            start = host.assembly.restart()
            wasted = host.last_words.shots_wasted if host.last_words else 0
            self.ledger.lost(plan, host.hello.boot, start, int(self._answer.get("laser_shots", 0)), wasted)
        call = host.upload_again(plan, self._now)
        while not call.done:
            yield
        call.result()

    def _call(self, operation: Operation, **body: Any) -> Iterator[None]:
        call = self._host.call(operation, self._now, **body)
        while not call.done:
            yield
        self._answer = call.result()
