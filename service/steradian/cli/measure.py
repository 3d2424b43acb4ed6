"""``steradian measure``: measure the width of an object in a volume and the point spread at that place."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.console import progress_bar, show_figures
from steradian.core.exceptions import InvalidInput


def measure(
    volume: Annotated[Path, typer.Argument(help="A volume file, or the folder of a reconstruction.")],
    scan: Annotated[Path, typer.Argument(help="The scan that it was reconstructed from.")],
    first: Annotated[str, typer.Option("--from", help="x,y,z in mm where the line begins, beside the object.")],
    last: Annotated[str, typer.Option("--to", help="x,y,z in mm where it ends, on the object's other side.")],
    frame: Annotated[int, typer.Option(help="Frame of the scan.")] = 0,
) -> None:
    """Measure an object's full width at half maximum, the point spread there, and the corrected diameter."""
    from steradian.reconstructions.studies.width import measure_width
    from steradian.reconstructions.volumes.file import read_parameters, read_volume

    file = volume / "volume.h5" if volume.is_dir() else volume
    ends = _place("from", first), _place("to", last)
    with progress_bar() as progress:
        found = measure_width(
            read_volume(file), scan, *ends, parameters=read_parameters(file), frame=frame, progress=progress
        )
    error = "" if found.repeatability is None else f", repeatability {1e6 * found.repeatability:.2g} µm"
    corrected = found.reason if found.corrected is None else f"{_micrometres(found.corrected)} ({found.shape})"
    if found.at_most is not None:
        corrected = f"at most {_micrometres(found.at_most)}: {found.reason}"
    figures = {
        "measured FWHM": f"{_micrometres(found.fwhm)}{error}",
        "point spread": "not simulated" if found.point_spread is None else _micrometres(found.point_spread),
        "corrected": corrected,
        "base": f"{found.base:.3g}, peak {found.height:.3g} above it",
    }
    show_figures("Width", figures)


def _micrometres(metres: float) -> str:
    return f"{1e6 * metres:.1f} µm"


def _place(name: str, text: str) -> tuple[float, ...]:
    """Parse a position ``x,y,z`` in mm; raises InvalidInput."""
    try:
        numbers = tuple(1e-3 * float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 3:
        raise InvalidInput(name, text, "x,y,z in mm, such as -0.5,0,2.5")
    return numbers
