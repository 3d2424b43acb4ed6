"""What a scanner says of the things that keep its laser from harm: interlock, key and shutter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import fabry_perot
from fabry_perot.wire.codes import INTERLOCK_CLOSED, KEY_ON, SHUTTER_OPEN

SILENCE = 3.0
"""Seconds without a word from a scanner after which what it said last does not hold any more."""
UNKNOWN = "unknown"


@dataclass(frozen=True)
class Guards:
    """What is read from them; of what the hardware cannot read, the device says the worse.

    Attributes
    ----------
    interlock, shutter
        ``open`` or ``closed``.
    key
        ``on`` or ``off``.
    """

    interlock: str = UNKNOWN
    key: str = UNKNOWN
    shutter: str = UNKNOWN

    @classmethod
    def of(cls, scanner: fabry_perot.Scanner | None) -> Self:
        """Read a scanner's last word; nothing is known where it is not connected, or has fallen silent."""
        if scanner is None:
            return cls()
        try:
            bits = scanner.status.laser
            if scanner.silence > SILENCE:
                return cls()
        except fabry_perot.ScannerError:
            return cls()
        return cls(
            interlock="closed" if bits & INTERLOCK_CLOSED else "open",
            key="on" if bits & KEY_ON else "off",
            shutter="open" if bits & SHUTTER_OPEN else "closed",
        )
