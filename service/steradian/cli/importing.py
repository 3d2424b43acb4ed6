"""``steradian import``: make a scan of somebody else's recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.console import progress_bar, show_end, show_figures


def import_(
    source: Annotated[
        Path,
        typer.Argument(
            help="IPASC or k-Wave HDF5, MATLAB with sensor_data and dt, .npy, .npz, .csv, or a scan file.",
            metavar="SOURCE",
        ),
    ],
    file: Annotated[Path, typer.Argument(help="The scan file to write (HDF5).", metavar="FILE")],
    description: Annotated[
        Path | None,
        typer.Option("--description", "-d", help="JSON with what the source does not say: times, positions, speed."),
    ] = None,
) -> None:
    """Make a scan file from a recording of another kind.

    What is imported counts as untrusted: links to other files, virtual datasets, object references, pickles,
    absurd sizes and compression bombs are refused, and it is read in a process of its own.
    """
    from steradian.scans.importing.guarded import import_guarded

    with progress_bar() as progress:
        summary = import_guarded(source, file, description=description, progress=progress)
    show_figures("Import", {"format": summary.format, "samples of an A-line": f"{summary.samples:,}"})
    show_end((f"{summary.points:,} A-lines", summary.path))
