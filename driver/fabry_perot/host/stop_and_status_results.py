"""Result types of scanner queries: status, outcome of an emergency stop, and record of a cleared fault."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

from fabry_perot import fault_codes
from fabry_perot.wire.constants import INTERLOCK_CLOSED, KEY_ON, LASER_ARMED, LASER_EMITTING, SHUTTER_OPEN
from fabry_perot.wire.messages import Status
from fabry_perot.wire.states import RUNNING, DeviceState

LIGHT = LASER_EMITTING | SHUTTER_OPEN
"""Laser bits of which each means that light can leave the aperture."""
_LIVE = RUNNING | {DeviceState.ARMED}
SWITCH = "use the hardware switch"
"""End of each sentence that says that a stop was not confirmed."""


@dataclass(frozen=True, slots=True)
class StopAnswer:
    """Outcome of an emergency stop.

    Parameters
    ----------
    laser
        ``"off"`` only if the device itself said so after the stop: its state is not live, its shutter reads closed and
        its monitor reads no light. Otherwise ``"unconfirmed"``.
    state
        The device's state in lower case, ``""`` unknown.
    shutter
        What the device said of its shutter after the stop.
    holder
        Program and process that holds the port; ``""`` if this call opened the port itself.
    detail
        One plain sentence; of an unconfirmed stop: why, ending in "use the hardware switch".
    seconds
        Time the stop took, in s.
    """

    laser: Literal["off", "unconfirmed"]
    state: str
    shutter: Literal["open", "closed", "unknown"]
    holder: str
    detail: str
    seconds: float


@dataclass(frozen=True, slots=True)
class PortStatus:
    """Device state, laser and fault as of its last STATUS.

    Parameters
    ----------
    holder
        Program and process that holds the port; ``""`` for this one.
    state
        The device's state in lower case.
    laser
        ``"on"`` while scanning, or when shutter or monitor say that light can leave; ``"armed"``; ``"off"``.
    shutter, interlock
        ``"open"`` or ``"closed"``, as the sensors read.
    key
        ``"on"`` or ``"off"``.
    fault
        Code of the latched fault (:mod:`fabry_perot.fault_codes`), 0 for none.
    age
        Seconds since that STATUS.
    """

    holder: str
    state: str
    laser: Literal["off", "armed", "on"]
    shutter: Literal["open", "closed"]
    interlock: Literal["open", "closed"]
    key: Literal["on", "off"]
    fault: int
    age: float


@dataclass(frozen=True, slots=True)
class FaultCleared:
    """Record of a fault that a person cleared.

    Parameters
    ----------
    fault
        The fault that was latched; code 0 for the emergency stop.
    by
        Name of the person, as given.
    at
        Time, in UTC.
    state
        The device's state afterwards, in lower case.
    """

    fault: fault_codes.Fault
    by: str
    at: datetime
    state: str

    def __str__(self) -> str:
        who = self.by or "an unnamed person"
        return f"{self.at:%Y-%m-%dT%H:%M:%SZ} {who} cleared the fault {self.fault.name}; state {self.state}"


def in_words(status: Status, age: float, holder: str = "") -> PortStatus:
    """Return a STATUS as a PortStatus, with states and faults by name.

    Parameters
    ----------
    status
        The message.
    age
        Seconds since it was received.
    holder
        Program and process that holds the port; ``""`` for this one.
    """
    bits = status.laser
    live = status.state in RUNNING
    armed = bits & LASER_ARMED or status.state == DeviceState.ARMED
    return PortStatus(
        holder=holder,
        state=DeviceState(status.state).name.lower(),
        laser="on" if bits & LIGHT or live else "armed" if armed else "off",
        shutter="open" if bits & SHUTTER_OPEN else "closed",
        interlock="closed" if bits & INTERLOCK_CLOSED else "open",
        key="on" if bits & KEY_ON else "off",
        fault=status.fault,
        age=age,
    )


def as_map(status: PortStatus) -> dict[str, Any]:
    """Return the fields of a result as a dictionary."""
    return {name: getattr(status, name) for name in PortStatus.__slots__}


def is_off(status: Status) -> bool:
    """Return whether a STATUS reports the laser off: not armed, not scanning, shutter closed, no emission."""
    return not status.laser & (LIGHT | LASER_ARMED) and status.state not in _LIVE


def standing(status: Status) -> str:
    """Return the persisting cause of a latched fault, as a clause; empty when the fault may be cleared."""
    bits = status.laser
    return fault_codes.standing(
        status.fault,
        interlock_closed=bool(bits & INTERLOCK_CLOSED),
        key_on=bool(bits & KEY_ON),
        light=bool(bits & LIGHT),
    )


def answer(status: Status | None, seconds: float, holder: str = "", trouble: str = "") -> StopAnswer:
    """Return the outcome of a stop from the device's STATUS.

    Parameters
    ----------
    status
        A STATUS that the device sent after it had acknowledged the stop; ``None`` when there was none.
    seconds
        Time the stop took, in s.
    holder
        Program and process that holds the port.
    trouble
        Why the stop is not confirmed, a clause; empty when only the STATUS decides.
    """
    if status is None:
        return unconfirmed(trouble or "the scanner did not answer", seconds, holder)
    state = DeviceState(status.state).name.lower()
    shutter: Literal["open", "closed"] = "open" if status.laser & SHUTTER_OPEN else "closed"
    if is_off(status) and not trouble:
        detail = f"the scanner reports that the laser is off (state {state}, shutter closed)"
        return StopAnswer("off", state, shutter, holder, detail, seconds)
    why = (
        trouble or f"the scanner reports {state}, shutter {shutter}{', light' if status.laser & LASER_EMITTING else ''}"
    )
    return StopAnswer("unconfirmed", state, shutter, holder, f"{why}; {SWITCH}", seconds)


def unconfirmed(why: str, seconds: float, holder: str = "") -> StopAnswer:
    """Return the outcome of a stop that the device did not confirm; ``why`` is a clause."""
    told = why if "could not be asked" in why else f"the scanner could not be asked: {why}"
    return StopAnswer("unconfirmed", "", "unknown", holder, f"{told}; {SWITCH}", seconds)
