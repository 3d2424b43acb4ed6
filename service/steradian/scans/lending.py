"""The scanner's port as it is lent to a scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import fabry_perot


class Port(Protocol):
    """Where the scanner is."""

    def present(self) -> str | None:
        """Return the port; ``None`` when there is no scanner, because a simulated one was not started."""
        ...


@dataclass
class Lent:
    """What is known of the scan that has the port.

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
