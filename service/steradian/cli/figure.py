"""``steradian figure``: figures for papers, and films of series."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from steradian.cli.console import finish_with_summary, length, quantity_option
from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from collections.abc import Iterator

    from steradian.imaging import Volume

SCALE, SIZE, FILM = "Colour scale", "Size", "Film"


def figure(
    sources: Annotated[
        list[Path], typer.Argument(help="Volume or series files, or folders of reconstructions.", metavar="SOURCE...")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="File to write: .pdf, .svg or .png; a film as .gif.")
    ] = Path("figure.pdf"),
    axis: Annotated[
        str, typer.Option(help="Axis of the projection, which disappears: x, y or z; several, as z,y: a panel each.")
    ] = "z",
    volumes: Annotated[str | None, typer.Option(help="Volumes of a series, from 0: 0,2,5; default: all.")] = None,
    depth_coded: Annotated[
        bool, typer.Option("--depth-coded", help="Colours are the depths of the maxima, values their brightness.")
    ] = False,
    near_field: Annotated[float, quantity_option(length, "0mm", help="Leave out what is above this depth.")] = 0.0,
    colour_map: Annotated[str, typer.Option(help="A colour map of matplotlib.", rich_help_panel=SCALE)] = "inferno",
    percentile: Annotated[
        float, typer.Option(help="Of a projection's values, at which colours end.", rich_help_panel=SCALE)
    ] = 99.9,
    limits: Annotated[
        str | None, typer.Option(help="Ends of the scale instead, such as 0:1.", rich_help_panel=SCALE)
    ] = None,
    gamma: Annotated[
        float, typer.Option(help="Exponent of the scale; below 1 brightens.", rich_help_panel=SCALE)
    ] = 1.0,
    log_range: Annotated[
        float | None, typer.Option(help="Range in dB of a logarithmic scale.", rich_help_panel=SCALE)
    ] = None,
    label: Annotated[
        str, typer.Option(help="Quantity and unit at the colour bar.", rich_help_panel=SCALE)
    ] = "initial pressure (arb. u.)",
    width: Annotated[
        float, quantity_option(length, "85mm", help="Width of the page; its height follows.", rich_help_panel=SIZE)
    ] = 85e-3,
    dpi: Annotated[float, typer.Option(help="Pixels an inch of a PNG.", rich_help_panel=SIZE)] = 300.0,
    font_size: Annotated[float, typer.Option(help="Size of letters in points.", rich_help_panel=SIZE)] = 7.0,
    interpolation: Annotated[
        str, typer.Option(help="Between voxels: nearest or linear.", rich_help_panel=SIZE)
    ] = "nearest",
    columns: Annotated[int | None, typer.Option(help="Most panels side by side; 4.", rich_help_panel=SIZE)] = None,
    scale_bar: Annotated[
        float | None, quantity_option(length, help="Length of the scale bar; 0: none.", rich_help_panel=SIZE)
    ] = None,
    interval: Annotated[float, typer.Option(help="Seconds that each volume is shown.", rich_help_panel=FILM)] = 0.2,
    size: Annotated[int, typer.Option(help="Longest side in pixels.", rich_help_panel=FILM)] = 480,
) -> None:
    """Write projections side by side with one colour scale, axes and a scale bar; or a film of a series."""
    from steradian.reconstructions.display import draw_volumes

    options: dict[str, Any] = {
        "axis": tuple(axis.split(",")),
        "near_field": near_field,
        "colour_map": colour_map,
        "label": label,
    }
    options |= {"percentile": percentile, "limits": None if limits is None else _limits(limits)}
    options |= {"depth_coded": depth_coded, "gamma": gamma, "log_range_db": log_range}
    film = output.suffix.lower() == ".gif"
    if film:
        options |= {"interval": interval, "size": size}
    else:
        bar = None if scale_bar is None else 1e3 * scale_bar
        options |= {"width": 1e3 * width, "dpi": dpi, "columns": columns, "scale_bar": bar}
        options |= {"font_size": font_size, "interpolation": interpolation}
    draw_volumes(_volumes(sources, volumes), output, film=film, **options)
    finish_with_summary(("film" if film else "figure", output))


def _volumes(sources: list[Path], chosen: str | None) -> Iterator[tuple[Volume, str]]:
    """Yield the volumes of all sources with their names, one after another."""
    import steradian
    from steradian.reconstructions.display import frame_name
    from steradian.reconstructions.series.series import Series

    for source in sources:
        opened = steradian.open(source)
        several = f"{source.stem}: " if len(sources) > 1 else ""
        if isinstance(opened, Series):
            for number in _numbers(chosen, len(opened)):
                yield opened[number], several + frame_name(opened.frames[number])
        elif isinstance(opened, steradian.Volume):
            yield opened, several.removesuffix(": ")
        else:
            raise InvalidInput("source", str(source), "volume or series files, or folders of reconstructions")


def _numbers(text: str | None, count: int) -> list[int]:
    if text is None:
        return list(range(count))
    try:
        numbers = [int(part) for part in text.split(",")]
    except ValueError:
        numbers = [-1]
    if not all(0 <= number < count for number in numbers):
        raise InvalidInput("volumes", text, f"numbers from 0 to {count - 1}, such as 0,{count - 1}")
    return numbers


def _limits(text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(":"))
    except ValueError:
        raise InvalidInput("limits", text, "two numbers, such as 0:1") from None
    return low, high
