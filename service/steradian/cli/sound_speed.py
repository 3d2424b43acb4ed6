"""``steradian sound-speed``: estimate the speed of sound, or the parameters of a layered medium."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from steradian.cli.medium_options import AttenuationOption, LayerOption, parse_medium
from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.scans.frames import FrameChoice


def sound_speed(
    file: Annotated[Path, typer.Argument(help="A scan file or another known recording.")],
    output: Annotated[Path, typer.Argument(help="Folder for the curve (JSON and PNG).")] = Path("sound-speed"),
    first: Annotated[
        float | None, quantity_option(speed, help="Slowest speed tried, without layers; default: 1380m/s.")
    ] = None,
    last: Annotated[
        float | None, quantity_option(speed, help="Fastest speed tried, without layers; default: 1620m/s.")
    ] = None,
    steps: Annotated[int, typer.Option(help="Speeds of the first round, ends included, without layers.")] = 25,
    layer: LayerOption = None,
    attenuation: AttenuationOption = None,
    search: Annotated[
        list[str] | None,
        typer.Option(
            metavar="<parameter>",
            help="Parameter of the medium to find: layer1.speed (layer 1 is at the film), layer1.thickness or "
            "time-zero; once for each. Default: the speeds of all layers.",
        ),
    ] = None,
    span: Annotated[
        float | None, typer.Option(help="Half-width of the ranges of --search, relative to the start; default: 0.1.")
    ] = None,
    frame: FrameOption = None,
    wavelength: WavelengthOption = None,
    average: AverageOption = False,
) -> None:
    """Estimate the speed of sound, or speeds and thicknesses of layers and time zero, with their standard errors."""
    from steradian.scans.frames import FrameChoice

    choice = FrameChoice(frame, wavelength, average)
    if layer or attenuation or search:
        for name, value in (("first", first), ("last", last)):
            if value is not None:
                raise InvalidInput(name, f"{value:g} m/s", "none beside --layer or --search; --span is their range")
        _search_medium(file, output, layer, attenuation, search, 0.1 if span is None else span, choice)
    elif span is not None:
        raise InvalidInput("span", span, "none without --layer or --search; --first and --last are the range")
    else:
        _search_speed(file, output, 1380.0 if first is None else first, 1620.0 if last is None else last, steps, choice)


def _search_speed(file: Path, output: Path, first: float, last: float, steps: int, choice: FrameChoice) -> None:
    from steradian.reconstructions.studies.sound_speed_search import scan_sound_speed

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


def _search_medium(
    file: Path,
    output: Path,
    layers: list[str] | None,
    attenuations: list[str] | None,
    search: list[str] | None,
    span: float,
    choice: FrameChoice,
) -> None:
    from steradian.reconstructions.parameters import ReconstructionParameters
    from steradian.reconstructions.studies.medium_scan import describe, scan_medium

    parameters = ReconstructionParameters.create(**parse_medium(layers, attenuations, None))
    names = search and [name.replace(".speed", ".sound_speed").replace("-", "_") for name in search]
    with progress_bar() as progress:
        found = scan_medium(file, output, parameters, names, span=span, frame=choice, progress=progress)
    figures = {each.name.replace("_", " "): describe(each) for each in found.parameters}
    show_figures("Medium", figures | {"files": format_files(output)})
    show_notes(found.notes)
    finish_with_summary(("curves", output))
