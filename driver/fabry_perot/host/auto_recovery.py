"""Automatic recovery of an interrupted scan within a safety policy.

Like the host it is sans-I/O: :meth:`ScanRecovery.poll` is told the time and looks at the host. It acts only on a scan
that a person started and nobody stopped, only within :attr:`RecoveryPolicy.within` seconds of the last proof that
application and device heard of each other, and only on a device that has kept power and whose interlock stayed closed.
Everything else waits for :meth:`ScanRecovery.resume`, a person's decision, which also plans again what a restarted
device has lost. The laser is armed anew by the full sequence RELEASE, ARM, START, never by a shortcut.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from fabry_perot.errors import LeaseExpired, LinkLost, ScannerError
from fabry_perot.host.host import Host
from fabry_perot.host.link_states import HostState
from fabry_perot.host.plan import WirePlan
from fabry_perot.host.shot_accounting import ShotLedger
from fabry_perot.wire.constants import SAFE_BITS, Operation
from fabry_perot.wire.states import DeviceState, HoldCause

_FIRST_WAIT, _LONGEST_WAIT = 50_000, 1_000_000
_RECOVERABLE = frozenset({HoldCause.LEASE, HoldCause.SESSION, HoldCause.NONE})
"""Causes of SAFE_HOLD that are interruptions rather than somebody's wish."""
_HALTED = frozenset({DeviceState.SAFE_HOLD, DeviceState.LINKED, DeviceState.READY, DeviceState.ARMED})

_OPERATOR_REQUIRED = (
    "the laser rests for too long, or not for the application alone: only a person may take the scan up"
)


@dataclass(frozen=True, slots=True)
class RecoveryPolicy:
    """Recovery policy of a scan: timeout, tolerated reboots, and time limit of a resume without a person.

    Parameters
    ----------
    patience
        Seconds without an A-line after which an interruption is given up.
    restarts
        Whether ``resume()`` may plan again what a restarted device lost; otherwise its restart ends the connection.
    within
        The laser comes back by itself at most so many seconds after the last contact; 0: never. Later, after the
        device was without power, and after its interlock or key was opened, only ``resume()`` brings it back.
    """

    patience: float = 10.0
    restarts: bool = True
    within: float = 2.0


class ScanRecovery:
    """Automatic recovery of one scan after interruptions of line or device.

    Parameters
    ----------
    host
        The host; told to tolerate restarts while a scan is kept.
    policy
        Limits.
    """

    def __init__(self, host: Host, policy: RecoveryPolicy) -> None:
        self._host, self._policy = host, policy
        self.ledger = ShotLedger()
        self.resumes = self.restarts = 0
        self.refusal: ScannerError | None = None
        """Why the last :meth:`resume` came to nothing."""
        self._plan: WirePlan | None = None
        self._steps: Iterator[None] | None = None
        self._asked = self._noticed = False
        self._boot = 0
        self._answer: dict[str, Any] = {}
        self._due = self._wait = self._moved = self._complete = self._now = 0

    @property
    def engaged(self) -> bool:
        """Whether a scan is monitored for recovery."""
        return self._plan is not None

    @property
    def busy(self) -> bool:
        """Whether a recovery is in progress."""
        return self._steps is not None

    @property
    def is_recovering(self) -> bool:
        """Whether the scan is interrupted and automatic recovery is in progress or permitted."""
        plan = self._plan
        return plan is not None and (self.busy or (self._interrupted(plan) and self._permitted()))

    @property
    def waiting(self) -> bool:
        """Whether the scan is interrupted and only a person may resume it."""
        plan = self._plan
        return plan is not None and not self.busy and self._interrupted(plan) and not self._permitted()

    def start(self, plan: WirePlan, laser_shots: int, now: int) -> None:
        """Start monitoring the scan of ``plan``; ``laser_shots`` is the value in the reply to START."""
        self._note_start(laser_shots)
        self._keep(plan, now)

    def resume(self, plan: WirePlan, now: int, *, by_itself: bool = False) -> None:
        """Start a resume of ``plan`` that a person decided, after any end; call :meth:`poll` until not :attr:`busy`.

        With ``by_itself`` nobody has, but the application that let the laser rest: the rule of when it may come back
        without a person holds, nothing is planned again, and :attr:`refusal` is LeaseExpired where it may not.
        """
        self._keep(plan, now)
        self._asked, self.refusal, self._steps = True, None, self._recover(plan, by_itself=by_itself)

    def _keep(self, plan: WirePlan, now: int) -> None:
        self._plan, self._steps, self._asked = plan, None, False
        self._host.tolerant = self._policy.restarts
        self._now = self._moved = self._due = now
        self._wait = _FIRST_WAIT

    def disable(self) -> None:
        """Disable automatic recovery, so that only a person can resume the scan."""
        self._plan, self._steps = None, None

    def release(self) -> None:
        """Stop monitoring the scan, because it was stopped or is complete."""
        self.disable()
        self._host.tolerant = False

    def poll(self, now: int) -> None:
        """Detect an interruption, or execute the next step of a recovery."""
        host, plan = self._host, self._plan
        if host.failure is not None:
            self.disable()  # nothing can be asked of it any more, and whoever waits has to be told
            return
        if plan is None:
            return
        self._now = now
        self._note_progress(now)
        if now - self._moved > self._policy.patience * 1e6 and not self._asked and not self._well():
            host.fail(LinkLost(f"no A-line for {self._policy.patience:g} s; the scan could not be taken up again"))
            return
        ours = not self.busy and now >= self._due and self._interrupted(plan) and self._permitted()
        if ours and self._noticed:
            self._steps = self._recover(plan)
        self._noticed = ours  # between two polls the application gets its say
        if self.busy:
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
            next(self._steps)
        except StopIteration:
            self._steps, self._asked, self._wait = None, False, _FIRST_WAIT
        except ScannerError as error:
            if self._asked:
                self.refusal = error
                self.disable()
                return
            # refused or unanswered: look again at how things stand, a little later
            self._steps, self._due = None, now + self._wait
            self._wait = min(2 * self._wait, _LONGEST_WAIT)

    def _known(self) -> bool:
        """Return whether the known state of the device is current."""
        host = self._host
        status, hello = host.status, host.hello
        if status is None or host.assembly is None or hello is None or host.phase in (HostState.LOST, HostState.HELLO):
            return False
        return status.boot == hello.boot and status.state == host.device_state

    def _interrupted(self, plan: WirePlan) -> bool:
        host = self._host
        if not self._known() or host.status is None or host.assembly is None or host.assembly.complete >= plan.length:
            return False
        if host.status.plan != plan.uid:
            return True
        return host.device_state in _HALTED and host.status.cause in _RECOVERABLE

    def _permitted(self) -> bool:
        """Return whether the laser may resume without a person: only contact was lost, and only briefly."""
        status, plan = self._host.status, self._plan
        if status is None or plan is None or (status.boot, status.plan) != (self._boot, plan.uid):
            return False
        if status.laser & SAFE_BITS != SAFE_BITS or status.cause == HoldCause.INTERLOCK:
            return False
        return self._host.seconds_since_contact(self._now) <= self._policy.within

    def _recover(self, plan: WirePlan, *, by_itself: bool = False) -> Iterator[None]:
        """Run the recovery steps until the device scans again; each ``yield`` waits for the next poll."""
        host, asked = self._host, self._asked
        while not self._known():
            yield
        if by_itself and not self._permitted():
            raise LeaseExpired(_OPERATOR_REQUIRED)
        assert host.status is not None  # noqa: S101
        anew = host.status.plan != plan.uid
        if anew:
            yield from self._plan_again(plan)
        else:
            host.ack_due = True
            if host.device_state is DeviceState.SAFE_HOLD:
                yield from self._call(Operation.RELEASE)
        while host.device_state is DeviceState.LINKED:
            yield
        if not asked and host.device_state not in (DeviceState.READY, DeviceState.ARMED):
            return  # it scans, or somebody or a fault has stopped it meanwhile
        yield from self._call(Operation.ARM)
        token = self._answer["token"]
        if (by_itself or not asked) and not self._permitted():
            yield from self._call(Operation.DISARM)
            if by_itself:
                raise LeaseExpired(_OPERATOR_REQUIRED)
            return
        yield from self._call(Operation.START, token=token, **host.lease_fields())
        self._note_start(int(self._answer.get("laser_shots", 0)))
        self.resumes += not anew and not asked

    def _note_start(self, laser_shots: int) -> None:
        host = self._host
        if host.hello is not None and host.uploader is not None and host.status is not None:
            self._boot, status = host.hello.boot, host.status
            self.ledger.record_start(
                host.hello.boot, host.uploader.start, laser_shots, status.shots_wasted, status.shots
            )

    def _plan_again(self, plan: WirePlan) -> Iterator[None]:
        yield from self._call(Operation.GET)
        host = self._host
        if host.assembly is not None and host.hello is not None:
            start = host.assembly.reset_pending()
            wasted = host.last_words.shots_wasted if host.last_words else 0
            self.ledger.record_reboot(plan, host.hello.boot, start, int(self._answer.get("laser_shots", 0)), wasted)
        call = host.upload_again(plan, self._now)
        while not call.done:
            yield
        call.result()
        self.restarts += 1

    def _call(self, operation: Operation, **body: Any) -> Iterator[None]:
        call = self._host.call(operation, self._now, **body)
        while not call.done:
            yield
        self._answer = call.result()
