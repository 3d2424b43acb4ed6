"""``steradian scanner``: show state, stop the laser and clear faults of a scanner directly, without a service."""

from __future__ import annotations

import getpass
import shlex
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from steradian.cli.console import console, show_figures
from steradian.core.exceptions import FaultStands, ScanFailed

if TYPE_CHECKING:
    import fabry_perot

HEARD_WITHIN = 3.0
"""Seconds for which a port is listened to."""
app = typer.Typer(
    no_args_is_help=True,
    help="""Show a scanner's state, stop its laser, or clear its fault: at its port, whether a service runs or not.

    The port may be held by another program: 'status' and 'stop' ask that one.""",
)
Port = Annotated[str, typer.Option("--scanner", help="Port of the scanner (/dev/ttyUSB0, socket://host:port).")]
Baud = Annotated[int | None, typer.Option("--baud", min=1, help="Baud rate of a UART. [default: 3000000]")]
By = Annotated[str | None, typer.Option("--by", metavar="NAME", help="Your name, for the record. [default: login]")]


@app.command("status")
def status(scanner: Port, baud: Baud = None) -> None:
    """Show the scanner's laser, shutter, interlock, key and latched fault; nothing is started or stopped.

    Ends with exit code 5 where the scanner is not heard.
    """
    import fabry_perot

    held = fabry_perot.port_status(scanner)
    if held is not None:
        _show(scanner, held)
        return
    with fabry_perot.Monitor(scanner, baudrate=baud) as monitor:
        until = time.monotonic() + HEARD_WITHIN
        while (seen := monitor.status) is None and time.monotonic() < until:
            time.sleep(0.05)
        if seen is None:
            raise ScanFailed(monitor.error or f"{scanner}: the scanner does not answer")
    _show(scanner, seen)


@app.command("stop")
def stop(scanner: Port, baud: Baud = None, by: By = None) -> None:
    """Turn the laser off, whichever program holds the port, and print the scanner's state afterwards.

    Takes two seconds at most. Ends with exit code 5 where the scanner did not confirm it: use the hardware switch.
    """
    import fabry_perot

    answer = fabry_perot.emergency_stop(scanner, baudrate=baud, who=by or _login())
    if answer.laser != "off":
        raise ScanFailed(f"laser {answer.laser}: {answer.detail}")
    holder = f" The port is held by {answer.holder}." if answer.holder else ""
    console().print(f"laser off: {answer.detail}.{holder}", soft_wrap=True, markup=False)


@app.command("clear-fault")
def clear_fault(scanner: Port, baud: Baud = None, by: By = None) -> None:
    """Clear the scanner's latched fault, once its cause is removed; the laser stays off.

    A scan that the fault interrupted is then resumed by 'steradian scan resume'. Ends with exit code 4 while the cause
    stands: the interlock is open, the key is off, the shutter is open.
    """
    import fabry_perot

    how: dict[str, Any] = {} if baud is None else {"baudrate": baud}
    try:
        with fabry_perot.connect(scanner, recovery=None, **how) as connected:
            if connected.state not in {"fault", "estop"}:
                console().print(f"no fault is latched; the scanner reports {connected.state}")
                return
            record = connected.clear_fault(by or _login())
    except fabry_perot.FaultStands as error:
        raise FaultStands(str(error)) from error
    except fabry_perot.ScannerError as error:
        raise ScanFailed(str(error)) from error
    console().print(str(record), soft_wrap=True, markup=False)


def clearing_command(scanner: str) -> str:
    """Return the command line that clears the fault of the scanner at a port, for use in messages."""
    return shlex.join(["steradian", "scanner", "clear-fault", "--scanner", scanner])


def _login() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):  # a user without a name, as in a container
        return "an unnamed user"


def _show(scanner: str, seen: fabry_perot.PortStatus) -> None:
    from steradian.scans.acquisition.scanner_status import fault_of

    fault = fault_of(seen)
    figures: dict[str, object] = {
        "at": scanner,
        "state": seen.state,
        "laser": seen.laser,
        "shutter": seen.shutter,
        "interlock": seen.interlock,
        "key": seen.key,
        "fault": "none" if fault is None else f"{fault['title']} ({fault['name']}); {fault['remedy']}",
        "heard": f"{seen.age:.1f} s ago",
        "port": f"held by {seen.holder}" if seen.holder else "free",
    }
    if fault is not None and fault["clearable"]:
        figures["clear it by"] = clearing_command(scanner)
    show_figures("Scanner", figures)
