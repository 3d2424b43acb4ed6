"""Names, descriptions and remedies of the device's fault codes (FAULT and STATUS in PROTOCOL.md)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Fault:
    """Kind of fault: code, name, description and remedy.

    Parameters
    ----------
    code
        Number in STATUS and FAULT; 0 is the latched emergency stop, which has no number of its own.
    name
        Stable name for programs, for example ``"interlock-opened"``.
    title
        What happened, a clause without a full stop.
    remedy
        What a person does before the fault is cleared, a clause without a full stop.
    """

    code: int
    name: str
    title: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.title} ({self.name})"


INTERLOCK_OPENED = Fault(
    1,
    "interlock-opened",
    "the interlock was opened while the laser was armed",
    "close the enclosure and reset its interlock",
)
KEY_TURNED_OFF = Fault(
    2, "key-turned-off", "the key switch was turned off while the laser was armed", "turn the key switch on again"
)
SHUTTER_STUCK = Fault(
    3,
    "shutter-stuck",
    "the shutter is open, or the laser emits after the close command",
    "use the hardware switch, then find out why the shutter did not close",
)
EMERGENCY_STOP = Fault(0, "emergency-stop", "the emergency stop is latched", "make sure that no person is in danger")
_OWN_PARTS = {4: "galvo", 5: "interrogation laser", 6: "digitiser", 7: "excitation laser", 8: "shutter and interlock"}
"""Numbers of :class:`fabry_perot.ComposedInstrument`; other hardware has a list of its own."""
_KNOWN = {fault.code: fault for fault in (EMERGENCY_STOP, INTERLOCK_OPENED, KEY_TURNED_OFF, SHUTTER_STUCK)}
CODES = range(256)
"""All fault codes that STATUS can carry, and 0 for the emergency stop."""


def by_code(code: int) -> Fault:
    """Return the fault with a code; hardware-specific codes (4 … 255) get a name that contains the number.

    Parameters
    ----------
    code
        As in STATUS; 0 for the latched emergency stop.
    """
    if code in _KNOWN:
        return _KNOWN[code]
    part = f"; of a ComposedInstrument this is the {_OWN_PARTS[code]}" if code in _OWN_PARTS else ""
    remedy = "look for the cause in the log of the scanner's own program, and for the number in its manual"
    return Fault(code, f"hardware-fault-{code}", f"the scanner's hardware reports its fault {code}{part}", remedy)


def standing(code: int, *, interlock_closed: bool, key_on: bool, light: bool) -> str:
    """Return the persisting cause of a fault, as a clause; empty when the fault may be cleared.

    Parameters
    ----------
    code
        As in STATUS; 0 for the latched emergency stop.
    interlock_closed, key_on
        What the interlock loop and the key switch read now.
    light
        Whether the shutter reads open or the laser's monitor reads light.
    """
    if light:
        return "the shutter is open or the laser emits"
    if code in (INTERLOCK_OPENED.code, KEY_TURNED_OFF.code):
        if not interlock_closed:
            return "the interlock is open"
        if not key_on:
            return "the key switch is off"
    return ""


def advice(code: int, port: str = "PORT") -> str:
    """Return one sentence with a fault's description, its remedy and the command that clears the fault.

    Parameters
    ----------
    code
        As in STATUS; 0 for the latched emergency stop.
    port
        The scanner's port, for the command.
    """
    fault = by_code(code)
    command = f"fabry-perot clear-fault {port} --by NAME"
    return f"{fault}; {fault.remedy}, then clear the fault (`{command}`) and resume"
