"""``steradian measure``: widths, diameters and regions of objects in a volume or series."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from steradian.cli.console import console, finish_with_summary, length, progress_bar, quantity_option, show_figures
from steradian.cli.measure_regions import RegionOptions, measure_regions, show_table
from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.reconstructions.parameters import ReconstructionParameters
    from steradian.reconstructions.series.series import Series

LINE, VESSEL, REGIONS = "Width along a line", "Diameter of a vessel", "Regions"


def measure(
    volume: Annotated[Path, typer.Argument(help="A volume or series file, or the folder of a reconstruction.")],
    scan: Annotated[
        Path | None, typer.Argument(help="The scan that it was reconstructed from, for the point spread.")
    ] = None,
    first: Annotated[
        str | None,
        typer.Option("--from", help="x,y,z in mm where the line begins, beside the object.", rich_help_panel=LINE),
    ] = None,
    last: Annotated[
        str | None,
        typer.Option("--to", help="x,y,z in mm where it ends, on the object's other side.", rich_help_panel=LINE),
    ] = None,
    vessel: Annotated[
        str | None,
        typer.Option(help="x,y,z in mm of a point on the vessel, in each volume of a series.", rich_help_panel=VESSEL),
    ] = None,
    point_spread: Annotated[
        float | None,
        quantity_option(
            length, help="Its width (FWHM), instead of the scan; taken for Gaussian.", rich_help_panel=VESSEL
        ),
    ] = None,
    along: Annotated[
        float,
        quantity_option(length, "600um", help="Length of the vessel with lines across it.", rich_help_panel=VESSEL),
    ] = 0.6e-3,
    lines: Annotated[int, typer.Option(help="Number of lines across.", rich_help_panel=VESSEL)] = 9,
    region: Annotated[
        list[str] | None,
        typer.Option(
            help="A file of regions (JSON), or in mm: 'box NAME x0:x1,y0:y1,z0:z1', 'ellipsoid NAME x,y,z rx,ry,rz',"
            " 'polygon NAME z x,y;x,y;x,y z0:z1', 'above 0.5 box …' for what reaches a share of its maximum.",
            rich_help_panel=REGIONS,
        ),
    ] = None,
    background: Annotated[
        str | None, typer.Option(help="Region for the contrast to noise: a name or a text.", rich_help_panel=REGIONS)
    ] = None,
    fit: Annotated[
        str, typer.Option(help="Change over time to fit: none, step or exponential.", rich_help_panel=REGIONS)
    ] = "none",
    courses: Annotated[
        Path | None, typer.Option(help="CSV file of each region's course over time.", rich_help_panel=REGIONS)
    ] = None,
    tsnr: Annotated[
        Path | None,
        typer.Option(help="Volume file (.h5) for each voxel's mean over its deviation.", rich_help_panel=REGIONS),
    ] = None,
    keep: Annotated[
        bool,
        typer.Option("--keep", help="Keep the regions beside the series (regions.json).", rich_help_panel=REGIONS),
    ] = False,
    frame: Annotated[int, typer.Option(help="Frame of the scan.")] = 0,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="CSV file for the table.")] = None,
) -> None:
    """Measure widths, vessel diameters and regions.

    The full width at half maximum along a line (--from, --to) with the point spread there and the corrected diameter;
    or, in a volume or all volumes of a series, the diameter of a vessel by lines across it (--vessel), or the
    statistics of regions (--region) with their courses over time.
    """
    if vessel is None and first is None and last is None:
        options = RegionOptions(region or (), background, fit, output, courses, tsnr, keep)
        measure_regions(open_series(volume)[0], volume if volume.is_dir() else volume.parent, options)
        return
    if vessel is not None:
        if first is not None or last is not None:
            raise InvalidInput("vessel", vessel, "nothing beside --from and --to")
        settings = {"point_spread": point_spread, "length": along, "lines": lines}
        _measure_vessel(volume, scan, _place("vessel", vessel), frame, settings, output)
        return
    if first is None or last is None:
        raise InvalidInput("vessel", "missing", "a place on a vessel, or a line by --from and --to")
    if scan is None:
        raise InvalidInput("scan", "missing", "the scan of the volume, where a line is measured")
    _measure_line(volume, scan, _place("from", first), _place("to", last), frame)


def _measure_line(volume: Path, scan: Path, start: tuple[float, ...], end: tuple[float, ...], frame: int) -> None:
    from steradian.reconstructions.studies.width import measure_width
    from steradian.reconstructions.volumes.file import read_parameters, read_volume

    file = volume / "volume.h5" if volume.is_dir() else volume
    with progress_bar() as progress:
        found = measure_width(
            read_volume(file), scan, start, end, parameters=read_parameters(file), frame=frame, progress=progress
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


def _measure_vessel(
    path: Path, scan: Path | None, place: tuple[float, ...], frame: int, options: dict[str, Any], output: Path | None
) -> None:
    from steradian.reconstructions.studies.diameter import measure_diameters
    from steradian.scans.opening import open_recording

    series, parameters = open_series(path)
    recording = None if scan is None else open_recording(scan, frame)
    with progress_bar() as progress:
        found = measure_diameters(
            series, place, recording=recording, parameters=parameters, progress=progress, **options
        )
    spread = found[0].point_spread
    shown, rows = [], []
    for of, each in zip(series.frames, found, strict=True):
        told = (
            each.reason
            if each.diameter is None
            else f"{_micrometres(each.diameter)} ± {1e6 * (each.standard_error or 0):.2g}"
        )
        if each.at_most is not None:
            told = f"at most {_micrometres(each.at_most)}"
        shown.append({"volume": str(of), "FWHM": _micrometres(each.fwhm), "diameter": told, "lines": str(each.lines)})
        x, y, z = each.centre
        about = {name: value for name, value in asdict(each).items() if name != "centre"}
        rows.append(
            {"frames": of.numbers, "excitation": of.excitation, "time": of.time} | about | {"x": x, "y": y, "z": z}
        )
    console().print(f"point spread: {'not known' if spread is None else _micrometres(spread)}")
    show_table("Diameter", shown)
    if output is not None:
        from steradian.quality.tables import write_csv

        write_csv(rows, output)
        finish_with_summary((f"{len(rows)} rows", output))


def open_series(path: Path) -> tuple[Series, ReconstructionParameters | None]:
    """Open a series, or a volume as a series of one, with the parameters of its reconstruction where they are known."""
    import steradian
    from steradian.reconstructions.series.frames import SeriesFrame
    from steradian.reconstructions.series.series import Series
    from steradian.reconstructions.volumes.file import read_parameters

    opened = steradian.open(path)
    if path.is_dir():
        path = next(file for name in ("volume.h5", "series.h5") if (file := path / name).is_file())
    if isinstance(opened, Series):
        return opened, read_parameters(path)
    if isinstance(opened, steradian.Volume):
        volume = opened
        return Series([SeriesFrame((0,))], lambda _: volume), read_parameters(path)
    raise InvalidInput("volume", str(path), "a volume or series file, or the folder of a reconstruction")


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
