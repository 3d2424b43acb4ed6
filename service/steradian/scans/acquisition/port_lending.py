"""Address of the scanner's port, and its state while a scan uses the port."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import fabry_perot


class Port(Protocol):
    """Protocol of a provider of the scanner's port address."""

    def present(self) -> str | None:
        """Return the port's address; ``None`` if the simulated scanner has not been started."""
        ...


@dataclass
class LentPort:
    """State of the port while a scan uses it: connection, and whether the laser may fire.

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
