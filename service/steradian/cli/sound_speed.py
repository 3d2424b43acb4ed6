"""``steradian sound-speed``: estimate the speed of sound by autofocus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.console import (
    finish_with_summary,
    format_files,
    progress_bar,
    quantity_option,
    show_figures,
    show_notes,
    speed,
)
from steradian.cli.frame_options import AverageOption, FrameOption, WavelengthOption


def sound_speed(
    file: Annotated[Path, typer.Argument(help="A scan file or another known recording.")],
    output: Annotated[Path, typer.Argument(help="Folder for the curve (JSON and PNG).")] = Path("sound-speed"),
    first: Annotated[float, quantity_option(speed, "1380m/s", help="Slowest speed tried.")] = 1380.0,
    last: Annotated[float, quantity_option(speed, "1620m/s", help="Fastest speed tried.")] = 1620.0,
    steps: Annotated[int, typer.Option(help="Speeds of the first round, ends included.")] = 25,
    frame: FrameOption = None,
    wavelength: WavelengthOption = None,
    average: AverageOption = False,
) -> None:
    """Estimate the speed of sound, its standard error and its dependence on a delay; draw sharpness against speed."""
    from steradian.reconstructions.studies.sound_speed_search import scan_sound_speed
    from steradian.scans.frames import FrameChoice

    choice = FrameChoice(frame, wavelength, average)
    with progress_bar() as progress:
        curve = scan_sound_speed(file, output, first=first, last=last, steps=steps, frame=choice, progress=progress)
    error = "" if curve.standard_error is None else f" ± {curve.standard_error:.2f}"
    figures = {
        "sound speed": f"{curve.best:.2f}{error} m/s",
        "range": f"{first:g} … {last:g} m/s" + (", whose end fits best: move it" if curve.at_edge else ""),
        "files": format_files(output),
    }
    show_figures("Speed of sound", figures)
    show_notes(curve.notes)
    finish_with_summary(("curve", output))
