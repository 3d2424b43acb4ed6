"""``steradian mask compare``: compare masks by metrics and by reconstructions of a simulated object."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer
from rich.table import Table

from steradian.cli.console import (
    console,
    finish_with_summary,
    frequency,
    length,
    plot_option,
    progress_bar,
    quantity_option,
)
from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.comparisons import Comparison, StagedScan
    from steradian.masks import Mask

STAGED = "staged"
"""Name of the candidate that is a survey and a focus on what the survey shows."""
SIMULATED_PANEL = "An object seen through each"
Row = tuple[str, list[str], list[float] | None]
"""A figure's name, its texts, and what is compared, the greatest being the best; none: nothing is."""


def compare(
    masks: Annotated[
        list[str] | None,
        typer.Argument(
            help="Mask files (.json), or arrangements: equi-steradian, grid, hexagonal, poisson-disc, random, perhaps"
            " with a number of points (grid:2000); or staged, with --phantom: a survey, then a focus on what it shows."
            " Default: all five arrangements.",
        ),
    ] = None,
    aperture: Annotated[
        float, quantity_option(length, "13.56mm", help="Side of the aperture of arrangements.")
    ] = 13.56e-3,
    depth: Annotated[
        float, quantity_option(length, "3.6mm", help="Distance of the point of interest, for all.")
    ] = 3.6e-3,
    offset_x: Annotated[float, quantity_option(length, help="Point of interest along x from the centre.")] = 0.0,
    offset_y: Annotated[float, quantity_option(length, help="The same along y.")] = 0.0,
    count: Annotated[int, typer.Option(help="Number of points of arrangements; the nearest possible is taken.")] = 1600,
    pulse_rate: Annotated[float, quantity_option(frequency, "50Hz", help="Laser pulses per second.")] = 50.0,
    noise: Annotated[float, typer.Option(help="Highest peak over the noise's standard deviation, in dB.")] = 30.0,
    phantom: Annotated[
        str | None,
        typer.Option(
            help="Simulate and reconstruct an object through each mask: vessel-tree, yarn or a volume file (.h5); "
            "not those of the simulated scanner.",
            rich_help_panel=SIMULATED_PANEL,
        ),
    ] = None,
    phantom_radius: Annotated[
        float | None,
        quantity_option(length, help="Its lateral radius; vessel-tree and yarn.", rich_help_panel=SIMULATED_PANEL),
    ] = None,
    region: Annotated[
        float | None,
        quantity_option(
            length,
            help="Diameter of the region around the point of interest; default: twice its depth.",
            rich_help_panel=SIMULATED_PANEL,
        ),
    ] = None,
    modes: Annotated[
        int | None, typer.Option(help="Lateral modes; default: of 60 um.", rich_help_panel=SIMULATED_PANEL)
    ] = None,
    iterations: Annotated[
        int, typer.Option(help="Of the iterative reconstruction, 0 for none.", rich_help_panel=SIMULATED_PANEL)
    ] = 30,
    survey: Annotated[
        int | None,
        typer.Option(
            help="Points of the survey of a staged scan; default: an eighth.", rich_help_panel=SIMULATED_PANEL
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of points by chance, of the object and of the noise.")] = 0,
    plot: Annotated[Path | None, plot_option("Also draw them side by side, for example into compare.png.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print all figures as JSON instead of a table.")] = False,
) -> None:
    """Compare masks for one point of interest: metrics, and an object reconstructed through each.

    With --phantom the scan of a known object is simulated and reconstructed through each mask, directly and
    iteratively, and compared with the object around the point of interest and over the whole field.
    """
    from steradian.comparisons import compare_masks

    named = _load_masks(masks, aperture, depth, (offset_x, offset_y), count, seed, survey)
    point = (offset_x, offset_y, depth)
    thing = None if phantom is None else _load_phantom(phantom, point, phantom_radius, seed)
    with progress_bar() as progress:
        found = compare_masks(
            named,
            point_of_interest=point,
            pulse_rate=pulse_rate,
            noise=noise,
            phantom=thing,
            region=region,
            modes=modes,
            iterations=iterations,
            seed=seed,
            progress=progress,
        )
    if plot is not None:
        from steradian.comparisons.plots import draw_comparison

        draw_comparison(found, plot)
    if as_json:
        typer.echo(json.dumps(found.as_json(), indent=2))
        return
    _show(found)
    if plot is not None:
        finish_with_summary(("picture", plot))


def _load_masks(
    given: list[str] | None,
    aperture: float,
    depth: float,
    offset: tuple[float, float],
    count: int,
    seed: int,
    survey: int | None,
) -> dict[str, Mask | StagedScan]:
    """Read or create each mask, and return the masks by unique names."""
    from steradian.comparisons import StagedScan
    from steradian.masks import Counted, mask_by_count, read_mask

    found: dict[str, Mask | StagedScan] = {}
    mask: Mask | StagedScan
    for text in given or get_args(Counted):
        name, _, number = text.partition(":")
        if name in (*get_args(Counted), STAGED):
            if number and not number.isdigit():
                raise InvalidInput("masks", text, "a number of points after the colon, such as grid:2000")
            points = int(number) if number else count
            if name == STAGED:
                mask = StagedScan(aperture, points, survey, seed)
            else:
                mask = mask_by_count(name, aperture, points, depth=depth, offset=offset, seed=seed)  # type: ignore[arg-type]
            name = text
        elif Path(text).is_file():
            mask, name = read_mask(Path(text)), Path(text).stem
        else:
            raise InvalidInput("masks", text, "a mask file, or one of " + ", ".join((*get_args(Counted), STAGED)))
        if name in found:
            name = f"{name} ({sum(other.startswith(name) for other in found) + 1})"
        found[name] = mask
    return found


def _load_phantom(name: str, point: tuple[float, float, float], radius: float | None, seed: int) -> Any:
    """Create the simulated object by its name, or read it from a file."""
    if Path(name).is_file():
        from steradian.reconstructions.volumes.file import read_volume

        return read_volume(Path(name))
    from steradian.comparisons import phantom

    return phantom(name, point, radius, seed=seed)


def _show(found: Comparison) -> None:
    """Print the comparison as a table with metrics as rows and masks as columns; the best value of a row is bold."""
    depth = f"{1e3 * found.point_of_interest[2]:.4g} mm"
    table = Table(title=f"Masks, point of interest {depth} deep", title_justify="left", title_style="bold", box=None)
    table.add_column("", style="cyan", no_wrap=True)
    for name in found.masks:
        table.add_column(name, justify="right")
    for title, texts, values in (*_promised_rows(found), *_simulated_rows(found)):
        best = max(values) if values else None
        marked = [
            f"[bold green]{text}[/]" if values and values[place] == best and min(values) < max(values) else text
            for place, text in enumerate(texts)
        ]
        table.add_row(title, *marked)
    console().print(table, "")
    for line in _summarise(found):
        console().print(line)


def _promised_rows(found: Comparison) -> list[Row]:
    all_ = [found.promised[name] for name in found.masks]
    return [
        ("points", [f"{p.points:,}" for p in all_], None),
        ("spacing", [f"{1e6 * p.finest_m:.0f}–{1e6 * p.coarsest_m:.0f} µm" for p in all_], None),
        (
            "solid angles vary (rim)",
            ["–" if p.solid_angle_spread is None else f"{100 * p.solid_angle_spread:.1f} %" for p in all_],
            [float("-inf") if p.solid_angle_spread is None else -p.solid_angle_spread for p in all_],
        ),
        ("share of directions sensed", [f"{100 * p.view:.0f} %" for p in all_], None),
        ("steepest edges seen", [f"{p.steepest_deg:.0f}°" for p in all_], None),
        (
            f"ball of {1e6 * all_[0].true_m:.0f} µm, wide × deep",
            [f"{1e6 * p.lateral_m:.0f} × {1e6 * p.axial_m:.0f} µm" for p in all_],
            None,
        ),
        ("its amplitude", [f"{p.amplitude:.2f}" for p in all_], None),
        ("its expected contrast", [f"{p.contrast_db:.1f} dB" for p in all_], [p.contrast_db for p in all_]),
        ("shortest travel", [f"{1e3 * p.travel_m:.0f} mm" for p in all_], [-p.travel_m for p in all_]),
        (f"time at {found.pulse_rate:g} Hz", [f"{p.seconds:.1f} s" for p in all_], None),
    ]


def _simulated_rows(found: Comparison) -> list[Row]:
    from steradian.comparisons.comparison import REGIONS

    rows: list[Row] = []
    for method in found.methods:
        for region, words in REGIONS.items():
            values = [getattr(found.simulated[name].by[method], region) for name in found.masks]
            mips = [getattr(found.simulated[name].by[method], f"{region}_mip") for name in found.masks]
            texts = [f"{value:.3f} ({mip:.3f})" for value, mip in zip(values, mips, strict=True)]
            rows.append((f"{method}, {words}", texts, values))
    return rows


TIE_TOLERANCE = 0.003
"""Correlations that differ by less are called alike: another draw of the noise moves each by up to 0.002."""


def _summarise(found: Comparison) -> list[str]:
    """Return one line for each metric that names the best mask."""
    from steradian.comparisons.comparison import REGIONS

    if found.simulation is None:
        return []
    lines = [
        "Correlations of volumes (of z-projections) with the object; around: within a cylinder of "
        f"{1e3 * found.simulation.region:.3g} mm."
    ]
    for method in found.methods:
        for region, words in REGIONS.items():
            (best, first), *others = found.ranking(region, method)
            alike = [name for name, value in others if first - value < TIE_TOLERANCE]
            if alike:
                names = f"{', '.join([best, *alike[:-1]])} and {alike[-1]}"
                lines.append(f"{method}, {words}: {names} are alike, within {TIE_TOLERANCE} of {first:.3f}.")
            else:
                second, next_ = others[0]
                lines.append(f"{method}, {words}: [bold]{best}[/] wins with {first:.3f} before {second}: {next_:.3f}.")
    return lines
