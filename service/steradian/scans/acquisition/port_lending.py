"""The scanner's port as it is lent to a scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import fabry_perot


class Port(Protocol):
    """Location of the scanner's port."""

    def present(self) -> str | None:
        """Return the port; ``None`` without a scanner, because a simulated one was not started."""
        ...


@dataclass
class Lent:
    """State of the scan that uses the port.

    Attributes
    ----------
    scanner
        Its connection; ``None`` before and after.
    may_fire
        Whether its scanner may fire at any moment.
    is_over
        Whether its connection has been closed again.
    """

    scanner: fabry_perot.Scanner | None = None
    may_fire: bool = False
    is_over: bool = False
