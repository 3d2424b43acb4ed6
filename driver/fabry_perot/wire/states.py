"""States of the device and the table of its state transitions."""

from __future__ import annotations

from enum import IntEnum, auto


class DeviceState(IntEnum):
    """State of the device; the number is that in STATUS."""

    BOOT = 0
    IDLE = 1
    """Self-test done, no host has spoken yet."""
    LINKED = 2
    """A session exists; no complete plan."""
    READY = 3
    """A plan is loaded; laser disarmed."""
    ARMED = 4
    """A token was given out; one START may follow."""
    SCANNING = 5
    STARVED = 6
    """Scanning, but the next point has not been uploaded yet; laser idle."""
    BLOCKED = 7
    """Scanning, but the ring is full of unacknowledged A-lines; laser idle."""
    DRAINING = 8
    """All points fired; A-lines await acknowledgement; laser off."""
    DONE = 9
    PAUSED = 10
    SAFE_HOLD = 11
    """Lease, link or session lost, or laser off asked for: laser off, plan and ring kept."""
    FAULT = 12
    ESTOP = 13


class Event(IntEnum):
    """Event that changes the state of the device."""

    SELF_TEST_PASSED = auto()
    NEW_SESSION = auto()
    PLAN_NEW = auto()
    PLAN_LOADED = auto()
    ARM = auto()
    ARM_EXPIRED = auto()
    DISARM = auto()
    START = auto()
    POINTS_SHORT = auto()
    POINTS_AT_HAND = auto()
    RING_FULL = auto()
    RING_FREED = auto()
    LAST_POINT_FIRED = auto()
    RING_EMPTY = auto()
    PAUSE = auto()
    LEASE_LAPSED = auto()
    LASER_OFF = auto()
    RELEASE = auto()
    RELEASE_WITHOUT_PLAN = auto()
    HARDWARE_FAULT = auto()
    EMERGENCY_STOP = auto()
    CLEAR_FAULT = auto()


class HoldCause(IntEnum):
    """Reason for SAFE_HOLD; in PAUSED, only whether the interlock was opened."""

    NONE = 0
    LEASE = 1
    SESSION = 2
    REQUEST = 3
    CLEARED = 4
    INTERLOCK = 5
    """Whatever it was before, the interlock has been opened or the key turned off since."""


S, E = DeviceState, Event
RUNNING = frozenset({S.SCANNING, S.STARVED, S.BLOCKED})
"""States of a scan in progress: these, and only these, need a lease."""
LATCHED_STATES = frozenset({S.FAULT, S.ESTOP})


def _build_transitions() -> dict[tuple[DeviceState, Event], DeviceState]:
    table = {
        (S.BOOT, E.SELF_TEST_PASSED): S.IDLE,
        (S.IDLE, E.NEW_SESSION): S.LINKED,
        (S.LINKED, E.PLAN_LOADED): S.READY,
        (S.READY, E.ARM): S.ARMED,
        (S.PAUSED, E.ARM): S.ARMED,
        (S.ARMED, E.ARM): S.ARMED,
        (S.ARMED, E.ARM_EXPIRED): S.READY,
        (S.ARMED, E.START): S.SCANNING,
        (S.ARMED, E.PAUSE): S.READY,
        (S.SCANNING, E.POINTS_SHORT): S.STARVED,
        (S.STARVED, E.POINTS_AT_HAND): S.SCANNING,
        (S.SCANNING, E.RING_FULL): S.BLOCKED,
        (S.BLOCKED, E.RING_FREED): S.SCANNING,
        (S.SCANNING, E.LAST_POINT_FIRED): S.DRAINING,
        (S.DRAINING, E.RING_EMPTY): S.DONE,
        (S.SAFE_HOLD, E.RELEASE): S.READY,
        (S.SAFE_HOLD, E.RELEASE_WITHOUT_PLAN): S.LINKED,
        (S.FAULT, E.CLEAR_FAULT): S.SAFE_HOLD,
        (S.ESTOP, E.CLEAR_FAULT): S.SAFE_HOLD,
    }
    for state in (S.LINKED, S.READY, S.DONE, S.DRAINING, S.PAUSED, S.SAFE_HOLD, *sorted(LATCHED_STATES)):
        table[state, E.NEW_SESSION] = state
    for state in (S.ARMED, *sorted(RUNNING)):
        table[state, E.NEW_SESSION] = S.SAFE_HOLD
        table[state, E.DISARM] = S.READY
        table[state, E.LASER_OFF] = S.SAFE_HOLD
    for state in sorted(RUNNING):
        table[state, E.PAUSE] = S.PAUSED
        table[state, E.LEASE_LAPSED] = S.SAFE_HOLD
    table[S.PAUSED, E.DISARM] = S.READY
    table[S.PAUSED, E.LASER_OFF] = S.SAFE_HOLD
    for state in (S.LINKED, S.READY, S.DONE, S.DRAINING, S.PAUSED, S.SAFE_HOLD):
        table[state, E.PLAN_NEW] = S.LINKED
    for state in S:
        if state is not S.ESTOP:
            table[state, E.EMERGENCY_STOP] = S.ESTOP
            if state is not S.FAULT:
                table[state, E.HARDWARE_FAULT] = S.FAULT
    return table


TRANSITIONS = _build_transitions()
"""(state, event) → next state; a pair that is not here is refused and changes nothing."""
