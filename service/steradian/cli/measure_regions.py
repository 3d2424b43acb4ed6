"""Regions of ``steradian measure``: their rows for each volume of a series, their courses, and maps over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from steradian.cli.console import console, finish_with_summary
from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.quality import RegionOfInterest
    from steradian.reconstructions.series.series import Series


@dataclass(frozen=True)
class RegionOptions:
    """Options of the command for regions, as given.

    Parameters
    ----------
    regions, background
        Texts or files of regions.
    fit
        "none", "step" or "exponential".
    output, courses
        CSV files of the rows and of the courses.
    map
        Volume file of the temporal signal-to-noise ratio.
    keep
        Whether the regions are kept beside the series.
    """

    regions: Sequence[str]
    background: str | None
    fit: str
    output: Path | None
    courses: Path | None
    map: Path | None
    keep: bool


def measure_regions(series: Series, folder: Path, options: RegionOptions) -> None:
    """Print and write the rows of all regions and volumes, and their courses over time."""
    from steradian.quality import summarise_courses, write_csv, write_regions

    regions, background = _read(options, folder)
    model: Any = None if options.fit == "none" else options.fit
    if options.fit not in ("none", "step", "exponential"):
        raise InvalidInput("fit", options.fit, "none, step, exponential")
    rows = series.measure(regions, background) if regions else []
    courses = summarise_courses(rows, model)
    if rows:
        show_table("Regions", [_shown(row) for row in rows])
    if len(series) > len(series.wavelengths or (0,)):
        show_table("Courses", [_shown_course(row) for row in courses])
    made: list[tuple[str, Path | None]] = []
    if options.output is not None:
        write_csv(rows, options.output)
        made.append((f"{len(rows)} rows", options.output))
    if options.courses is not None:
        write_csv(courses, options.courses)
        made.append((f"{len(courses)} courses", options.courses))
    if options.map is not None:
        made += [("temporal signal-to-noise ratio", path) for path in _write_maps(series, options.map)]
    if options.keep:
        write_regions(folder / "regions.json", regions, background)
        made.append(("regions", folder / "regions.json"))
    if made:
        finish_with_summary(*made)


def _read(options: RegionOptions, folder: Path) -> tuple[list[RegionOfInterest], RegionOfInterest | None]:
    """Return regions and background of texts and files; without any, those kept beside the series."""
    from steradian.quality import read_regions, region_from_text

    regions: list[RegionOfInterest] = []
    background: RegionOfInterest | None = None
    for given in options.regions or ([str(folder / "regions.json")] if (folder / "regions.json").is_file() else ()):
        if given.endswith(".json"):
            found, beside = read_regions(Path(given))
            regions += found
            background = background or beside
        else:
            regions.append(region_from_text(given))
    if options.background is not None:
        same = [each for each in regions if each.name == options.background]
        background = same[0] if same else region_from_text(options.background)
        regions = [each for each in regions if each is not background]
    names = [each.name for each in regions]
    if len(set(names)) < len(names):
        raise InvalidInput("region", ", ".join(names), "names that are different")
    if not regions and options.map is None:
        raise InvalidInput("region", "missing", "a region, or a file of regions")
    return regions, background


def _write_maps(series: Series, path: Path) -> list[Path]:
    """Write the temporal signal-to-noise ratio at each wavelength as a volume file; return their names."""
    from steradian.quality import temporal_snr

    if path.suffix.lower() != ".h5":
        raise InvalidInput("tsnr", path.name, "a volume file, .h5")
    if len(series.wavelengths) < 2:
        temporal_snr(series).save(path)
        return [path]
    made = []
    for light in series.wavelengths:
        made.append(path.with_name(f"{path.stem}-{1e9 * light:.0f}nm{path.suffix}"))
        temporal_snr(series.at(light)).save(made[-1])
    return made


def _shown(row: Mapping[str, Any]) -> dict[str, str]:
    about = {"region": row["name"], "volume": " ".join(map(str, row["frames"])), "nm": _nanometres(row["excitation"])}
    contrast = row["contrast_to_noise"]
    return about | {
        "time (s)": "" if row["time"] is None else f"{row['time']:.4g}",
        "voxels": f"{row['voxels']:,}",
        "mean": f"{row['mean']:.4g}",
        "deviation": f"{row['deviation']:.3g}",
        "maximum": f"{row['maximum']:.4g}",
        "contrast to noise": "" if contrast is None else f"{contrast:.3g}",
    }


def _shown_course(row: Mapping[str, Any]) -> dict[str, str]:
    ratio = row["temporal_snr"]
    shown = {"region": row["name"], "nm": _nanometres(row["excitation"]), "mean": f"{row['mean']:.4g}"}
    shown["temporal SNR"] = "" if ratio is None else f"{ratio:.3g}"
    for name in ("amplitude", "time", "time_constant"):
        if row.get(name) is not None:
            shown[name.replace("_", " ")] = f"{row[name]:.4g} ± {row[f'{name}_error']:.2g}"
    return shown


def _nanometres(excitation: float) -> str:
    return f"{1e9 * excitation:g}" if excitation else ""


def show_table(title: str, rows: Sequence[Mapping[str, str]]) -> None:
    """Print rows with the same names as a table; the names are its heading."""
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for number, name in enumerate(rows[0] if rows else ()):
        table.add_column(name, style=None if number else "cyan")
    for row in rows:
        table.add_row(*row.values())
    console().print(table, "")
