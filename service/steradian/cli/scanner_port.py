"""Scanner of a command: its port with the baud rate, or a simulator process for the duration of a block."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.plans import ScanPlan

PHANTOM = "yarn"


def at_baud(scanner: str, baud: int | None, plan: ScanPlan | None = None) -> str:
    """Return the scanner's address with a baud rate: the given one, else that of the plan's serial link.

    Parameters
    ----------
    scanner
        A port, which may name a baud rate itself, or ``simulated``, which has none.
    baud
        Asked for, in Bd.
    plan
        Plan whose link counts where none is asked for.

    Raises
    ------
    InvalidInput
        When the baud rate is out of range, or the scanner has none.
    """
    from fabry_perot import PlanInvalid
    from fabry_perot.host.address import names_baud, with_baud

    if baud is None:
        link = None if plan is None or "://" in scanner or names_baud(scanner) else plan.link
        baud = None if link is None or scanner == "simulated" else link.baudrate
    elif scanner == "simulated":
        raise InvalidInput("baud", baud, "none with a simulated scanner, or --scanner PORT")
    try:
        return scanner if baud is None else with_baud(scanner, baud)
    except PlanInvalid as error:
        raise InvalidInput(error.field, error.value, error.allowed) from error


@contextmanager
def scanner_port(scanner: str, *, speed: float, seed: int = 1, phantom: str = PHANTOM) -> Iterator[str]:
    """Yield the address of a scanner; for ``simulated``, start a simulator process for the duration of the block.

    Raises
    ------
    InvalidInput
        When the phantom is none.
    """
    if scanner != "simulated":
        yield scanner
        return
    from fabry_perot.simulator import launch
    from fabry_perot.simulator.named_phantoms import NAMES, by_name

    try:
        by_name(phantom)
    except (OSError, ValueError) as error:
        raise InvalidInput("phantom", phantom, f"{', '.join(NAMES)}, or an .npz file ({error})") from error
    with launch(speed=speed, seed=seed, phantom=phantom) as simulator:
        yield simulator.url
