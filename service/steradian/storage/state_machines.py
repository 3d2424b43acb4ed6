"""State machines of scans and jobs as transition tables."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Final, Self

from steradian.core.exceptions import Conflict


class ScanState(StrEnum):
    """States of a scan."""

    QUEUED = "queued"
    ARMING = "arming"
    RUNNING = "running"
    PAUSING = "pausing"
    PAUSED = "paused"
    STOPPING = "stopping"
    RECOVERING = "recovering"
    COMPLETING = "completing"
    ABORTING = "aborting"
    INTERRUPTED = "interrupted"
    COMPLETE = "complete"
    PARTIAL = "partial"
    ABORTED = "aborted"
    FAILED = "failed"


class ReconstructionState(StrEnum):
    """States of a reconstruction."""

    QUEUED = "queued"
    RUNNING = "running"
    CANCELLING = "cancelling"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"


class BatchState(StrEnum):
    """Combined state of a batch's jobs; ``forgotten`` if all of them were deleted by retention."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"
    FORGOTTEN = "forgotten"

    @classmethod
    def of(cls, counts: Mapping[str, int]) -> Self:
        """Return a batch's state from the number of its jobs in each state."""
        known = {state for state in ReconstructionState if counts.get(state)}
        if not known:
            return cls("forgotten")
        if known == {ReconstructionState.QUEUED}:
            return cls("queued")
        if any(not is_terminal(state) for state in known):
            return cls("running")
        return cls(next(state for state in ("failed", "cancelled", "succeeded") if state in known))


class DesiredJobState(StrEnum):
    """Desired state of a reconstruction."""

    SUCCEEDED = "succeeded"
    CANCELLED = "cancelled"


class DesiredScanState(StrEnum):
    """Desired state of a scan."""

    RUNNING = "running"
    PAUSED = "paused"
    STOPPED = "stopped"
    ABORTED = "aborted"


_S = ScanState
SCAN_TRANSITIONS: Final[Mapping[ScanState, frozenset[ScanState]]] = MappingProxyType(
    {
        # A scan that never fired needs nobody to switch off the laser, so it is aborted at once.
        _S.QUEUED: frozenset({_S.ARMING, _S.ABORTED}),
        _S.ARMING: frozenset({_S.RUNNING, _S.RECOVERING, _S.INTERRUPTED, _S.ABORTING, _S.FAILED}),
        _S.RUNNING: frozenset(
            {_S.COMPLETING, _S.PAUSING, _S.STOPPING, _S.RECOVERING, _S.INTERRUPTED, _S.ABORTING, _S.FAILED}
        ),
        _S.PAUSING: frozenset({_S.PAUSED, _S.INTERRUPTED, _S.ABORTING, _S.FAILED}),
        _S.PAUSED: frozenset({_S.ARMING, _S.STOPPING, _S.INTERRUPTED, _S.ABORTING, _S.FAILED}),
        _S.STOPPING: frozenset({_S.PARTIAL, _S.INTERRUPTED, _S.ABORTING, _S.FAILED}),
        _S.RECOVERING: frozenset({_S.RUNNING, _S.INTERRUPTED, _S.ABORTING, _S.FAILED}),
        _S.COMPLETING: frozenset({_S.COMPLETE, _S.INTERRUPTED, _S.ABORTING, _S.FAILED}),
        _S.ABORTING: frozenset({_S.ABORTED, _S.INTERRUPTED, _S.FAILED}),
        _S.INTERRUPTED: frozenset({_S.ARMING, _S.PARTIAL}),
        _S.COMPLETE: frozenset(),
        _S.PARTIAL: frozenset(),
        _S.ABORTED: frozenset(),
        _S.FAILED: frozenset(),
    }
)
"""Which state may follow which. Every active state may become ``interrupted``: the service may end at any moment."""

_R = ReconstructionState
RECONSTRUCTION_TRANSITIONS: Final[Mapping[ReconstructionState, frozenset[ReconstructionState]]] = MappingProxyType(
    {
        _R.QUEUED: frozenset({_R.RUNNING, _R.CANCELLING}),
        _R.RUNNING: frozenset({_R.SUCCEEDED, _R.FAILED, _R.CANCELLING, _R.QUEUED}),
        _R.CANCELLING: frozenset({_R.CANCELLED}),
        _R.SUCCEEDED: frozenset(),
        _R.FAILED: frozenset(),
        _R.CANCELLED: frozenset(),
    }
)
"""Which state may follow which; ``running → queued`` is a worker's death, at most twice."""

ACTIVE_SCAN_STATES: Final = frozenset(
    state for state, following in SCAN_TRANSITIONS.items() if following and state not in {_S.QUEUED, _S.INTERRUPTED}
)
"""States in which a process should be at work on the scan."""

SETTLED_SCAN_STATES: Final = frozenset(SCAN_TRANSITIONS) - ACTIVE_SCAN_STATES - {_S.QUEUED}
"""States that change only when a person asks: the terminal ones and ``interrupted``."""

_ENDS: Final = frozenset({DesiredScanState.STOPPED, DesiredScanState.ABORTED})
_GOING: Final = frozenset({DesiredScanState.RUNNING, DesiredScanState.PAUSED}) | _ENDS
ALLOWED_DESIRED_STATES: Final[Mapping[ScanState, frozenset[DesiredScanState]]] = MappingProxyType(
    {
        _S.QUEUED: _ENDS,
        _S.ARMING: _GOING,
        _S.RUNNING: _GOING,
        _S.PAUSING: _GOING,
        _S.PAUSED: _GOING,
        _S.RECOVERING: _GOING,
        _S.COMPLETING: _ENDS,
        _S.STOPPING: _ENDS,
        _S.ABORTING: frozenset({DesiredScanState.ABORTED}),
        # Nothing resumes an interrupted scan but this wish; there is nothing to abort any more, it is kept as it is.
        _S.INTERRUPTED: _ENDS | {DesiredScanState.RUNNING},
        **{state: frozenset[DesiredScanState]() for state, following in SCAN_TRANSITIONS.items() if not following},
    }
)
"""What may be wished of a scan in each state."""

IRREVERSIBLE_DESIRED_STATES: Final[Mapping[DesiredScanState, frozenset[DesiredScanState]]] = MappingProxyType(
    {DesiredScanState.STOPPED: frozenset({DesiredScanState.ABORTED}), DesiredScanState.ABORTED: frozenset()}
)
"""Wishes that cannot be taken back, and what may still be wished after them."""


def shortest_path(present: ScanState, goal: ScanState) -> tuple[ScanState, ...]:
    """Return the shortest sequence of transitions from one scan state to another, without the first state.

    A way leads through ``interrupted`` or ``aborting`` only when there is no other.

    Raises
    ------
    Conflict
        When there is none.
    """
    for avoided in (frozenset({_S.INTERRUPTED, _S.ABORTING}), frozenset[ScanState]()):
        ways: list[tuple[ScanState, ...]] = [()]
        seen = {present}
        for way in ways:
            here = way[-1] if way else present
            if here is goal:
                return way
            for following in sorted(SCAN_TRANSITIONS[here] - seen):
                if following is goal or following not in avoided:
                    seen.add(following)
                    ways.append((*way, following))
    raise Conflict(f"a scan that is {present} cannot become {goal}")


def is_terminal(state: ScanState | ReconstructionState) -> bool:
    """Return whether ``state`` has no following state."""
    if isinstance(state, ScanState):
        return not SCAN_TRANSITIONS[state]
    return not RECONSTRUCTION_TRANSITIONS[state]


def require_transition(identifier: str, present: ScanState, following: ScanState) -> None:
    """Raise :class:`Conflict` unless the transition table of scans allows a transition.

    Raises
    ------
    Conflict
        Naming both states and those that may follow.
    """
    _check(f"scan {identifier}", present, following, SCAN_TRANSITIONS[present])


def check_job_transition(identifier: str, present: ReconstructionState, following: ReconstructionState) -> None:
    """Raise :class:`Conflict` unless the transition table of jobs allows a transition."""
    _check(f"job {identifier}", present, following, RECONSTRUCTION_TRANSITIONS[present])


def _check(what: str, present: str, following: str, allowed: frozenset[ScanState] | frozenset[_R]) -> None:
    if following not in allowed:
        words = ", ".join(sorted(allowed)) or "nothing, it is final"
        raise Conflict(f"{what} is {present} and cannot become {following}; allowed: {words}")
