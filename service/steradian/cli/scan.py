"""``steradian scan``: measure."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.console import progress_bar, show_figures
from steradian.cli.files import read_value
from steradian.plans import ScanPlan


def scan(
    plan: Annotated[Path, typer.Argument(help="A plan file, made by 'steradian plan'.")],
    scanner: Annotated[
        str, typer.Option(help="Port of the scanner (/dev/ttyUSB0, socket://host:port), or 'simulated'.")
    ] = "simulated",
    simulator_speed: Annotated[
        float, typer.Option(help="How much faster than real time a simulated scan runs.")
    ] = 20.0,
    output: Annotated[Path, typer.Option("--output", "-o", help="The scan file to write (HDF5).")] = Path("scan.h5"),
) -> None:
    """Run a plan on a scanner and keep the A-lines in a scan file.

    However the scan ends, the file holds every A-line that was acknowledged and can be reconstructed.
    Ctrl-C turns the laser off.
    """
    from steradian.scans.run import run_scan

    wanted = read_value(ScanPlan, plan)
    with scanner_port(scanner, speed=simulator_speed) as port, progress_bar() as progress:
        summary = run_scan(wanted, port, output, progress=progress)
    figures = {
        "A-lines stored": f"{summary.stored} of {summary.points}",
        "shots fired": summary.fired,
        "file": summary.path,
    }
    show_figures("Scan" + (" (simulated)" if scanner == "simulated" else ""), figures)


@contextmanager
def scanner_port(scanner: str, *, speed: float, seed: int = 1) -> Iterator[str]:
    """Give the port of a scanner; for ``simulated``, of one started for the occasion in a process of its own."""
    if scanner != "simulated":
        yield scanner
        return
    from fabry_perot.simulator import launch

    with launch(speed=speed, seed=seed) as simulator:
        yield simulator.url
