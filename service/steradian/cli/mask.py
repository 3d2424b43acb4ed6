"""``steradian mask``: create masks of detection points, and show and compare their metrics."""

from __future__ import annotations

from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from steradian.cli import mask_compare
from steradian.cli.console import finish_with_summary, length, plot_option, quantity_option, show_figures
from steradian.core.choices import Weighting
from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.masks import Mask, PointOfInterest, ScannerGrid

app = typer.Typer(
    help="""Choose where on the sensor plane to sense; writes a mask file.

    The name of the file decides its kind: .json keeps everything, .csv and .npy hold x, y and weight of each point.
    Positions count from the centre of the aperture.""",
    no_args_is_help=True,
)

Aperture = Annotated[float, quantity_option(length, help="Side of the square aperture, e.g. 13.56mm.")]
Depth = Annotated[float, quantity_option(length, help="Distance of the point of interest from the sensor, e.g. 3.6mm.")]
OffsetX = Annotated[float, quantity_option(length, help="Point of interest along x from the centre, e.g. 2mm.")]
OffsetY = Annotated[float, quantity_option(length, help="The same along y.")]
OptionalDepth = Annotated[
    float | None,
    quantity_option(length, help="Depth of a point of interest for which the mask's metrics are printed."),
]
Count = Annotated[int, typer.Option(help="Number of points; the nearest possible number is used.")]
Output = Annotated[Path, typer.Option("--output", "-o", help="The mask file to write (.json, .csv or .npy).")]
Plot = Annotated[Path | None, plot_option("Also draw points, spacing, view and sharpness, e.g. mask.png.")]
Weights = Annotated[
    Weighting,
    typer.Option("--weights", help="voronoi: each point's own cell; analytic: the arrangement's rule; uniform."),
]
SnapInterval = Annotated[
    float | None, quantity_option(length, help="The scanner stops only on a grid of this interval, e.g. 60um.")
]
SnapCount = Annotated[int | None, typer.Option(help="Places of that grid on each axis, e.g. 226.")]
Seed = Annotated[int, typer.Option(help="The same seed gives the same points.")]
FILE = Path("mask.json")


@app.command("equi-steradian")
def equi_steradian(
    aperture: Aperture,
    depth: Depth,
    count: Count,
    offset_x: OffsetX = 0.0,
    offset_y: OffsetY = 0.0,
    snap_interval: SnapInterval = None,
    snap_count: SnapCount = None,
    weights: Weights = "voronoi",
    output: Output = FILE,
    plot: Plot = None,
) -> None:
    """Points that each cover the same solid angle seen from a point of interest.

    Few points are then enough: dense below the point of interest, sparse towards the rim.
    """
    from steradian.masks import convenient_counts, equi_steradian_mask

    offset, grid = (offset_x, offset_y), _grid(snap_interval, snap_count)
    mask = equi_steradian_mask(aperture, depth, count, offset=offset, grid=grid, weighting=weights)
    below, above = convenient_counts(aperture, depth, count, offset)
    _save_and_show(
        mask, output, plot, _report_count(mask.count, count, f"slices end on the rim with {below} and {above}")
    )


@app.command("equiangular")
def equiangular(
    aperture: Annotated[float, quantity_option(length, help="Length of the line of sensors, e.g. 13.56mm.")],
    depth: Depth,
    count: Annotated[int, typer.Option(help="Number of sensors.")],
    offset_x: OffsetX = 0.0,
    snap_interval: SnapInterval = None,
    snap_count: SnapCount = None,
    weights: Weights = "voronoi",
    output: Output = FILE,
    plot: Plot = None,
) -> None:
    """Sensors on a line at equal angles seen from a point of interest, for 2-D images."""
    from steradian.masks import equiangular_mask

    grid = _grid(snap_interval, snap_count)
    _save_and_show(
        equiangular_mask(aperture, depth, count, offset=offset_x, grid=grid, weighting=weights), output, plot
    )


@app.command("grid")
def grid(
    aperture: Aperture,
    count: Annotated[int | None, typer.Option(help="Total number of points; the nearest square is used.")] = None,
    per_axis: Annotated[int | None, typer.Option(help="Points on each axis, instead of --count.")] = None,
    interval: Annotated[
        float | None,
        quantity_option(length, help="Distance between neighbours, e.g. 300um; default: fills the aperture."),
    ] = None,
    depth: OptionalDepth = None,
    offset_x: OffsetX = 0.0,
    offset_y: OffsetY = 0.0,
    centred: Annotated[bool, typer.Option(help="Make an even grid symmetric to the centre.")] = False,
    weights: Weights = "analytic",
    output: Output = FILE,
    plot: Plot = None,
) -> None:
    """Points on a square grid."""
    from steradian.masks import grid_mask, nearest_square

    if (count is None) == (per_axis is None):
        raise InvalidInput("count", "both or neither of --count and --per-axis", "one of them")
    side = nearest_square(count) if count else per_axis or 0
    # what fills the aperture is symmetric to it; intervals of a scanner lie on its own places
    mask = grid_mask(
        aperture,
        side,
        interval or aperture / side,
        depth=depth,
        offset=(offset_x, offset_y),
        centred=centred or not interval,
        weighting=weights,
    )
    square = f"{side} × {side}"
    told = _report_count(mask.count, count, f"squares near it: {(side - 1) ** 2}, {side**2} and {(side + 1) ** 2}")
    _save_and_show(mask, output, plot, told if count else f"{mask.count} ({square})")


@app.command("hexagonal")
def hexagonal(
    aperture: Aperture,
    count: Annotated[int | None, typer.Option(help="Number of points; the nearest possible number is used.")] = None,
    interval: Annotated[
        float | None, quantity_option(length, help="Distance between neighbours, e.g. 300um, instead of --count.")
    ] = None,
    depth: OptionalDepth = None,
    offset_x: OffsetX = 0.0,
    offset_y: OffsetY = 0.0,
    weights: Weights = "analytic",
    output: Output = FILE,
    plot: Plot = None,
) -> None:
    """Points on a hexagonal lattice over the whole aperture: the fewest for an even spacing."""
    from steradian.masks import hexagonal_mask

    offset = (offset_x, offset_y)
    mask = hexagonal_mask(aperture, interval, count=count, depth=depth, offset=offset, weighting=weights)
    _save_and_show(mask, output, plot, _report_count(mask.count, count, "rows fit in steps"))


@app.command("random")
def random(
    aperture: Aperture,
    count: Annotated[int, typer.Option(help="Number of points.")],
    depth: OptionalDepth = None,
    offset_x: OffsetX = 0.0,
    offset_y: OffsetY = 0.0,
    seed: Seed = 0,
    weights: Weights = "voronoi",
    output: Output = FILE,
    plot: Plot = None,
) -> None:
    """Independent random points over the whole aperture."""
    from steradian.masks import random_mask

    offset = (offset_x, offset_y)
    _save_and_show(random_mask(aperture, count, depth=depth, offset=offset, seed=seed, weighting=weights), output, plot)


@app.command("poisson-disc")
def poisson_disc(
    aperture: Aperture,
    count: Annotated[int | None, typer.Option(help="Number of points; a search approximates it.")] = None,
    spacing: Annotated[
        float | None,
        quantity_option(length, help="Least distance between points, e.g. 250um, instead of --count."),
    ] = None,
    depth: OptionalDepth = None,
    offset_x: OffsetX = 0.0,
    offset_y: OffsetY = 0.0,
    seed: Seed = 0,
    weights: Weights = "voronoi",
    output: Output = FILE,
    plot: Plot = None,
) -> None:
    """Random points with a minimum distance from each other, as many as fit."""
    from steradian.masks import poisson_disc_mask

    offset = (offset_x, offset_y)
    mask = poisson_disc_mask(aperture, spacing, count=count, depth=depth, offset=offset, seed=seed, weighting=weights)
    _save_and_show(mask, output, plot, _report_count(mask.count, count, "their number jumps with the spacing"))


@app.command("combined")
def combined(
    aperture: Aperture,
    point: Annotated[
        list[str],
        typer.Option(help="A point of interest as x,y,depth,count, e.g. 2mm,-1mm,3.6mm,800; give several."),
    ],
    snap_interval: SnapInterval = None,
    snap_count: SnapCount = None,
    weights: Weights = "voronoi",
    output: Output = FILE,
    plot: Plot = None,
) -> None:
    """Points for several points of interest: each place is as dense as the most demanding of them requires."""
    from steradian.masks import combined_mask

    points = [_point_of_interest(text) for text in point]
    grid = _grid(snap_interval, snap_count)
    _save_and_show(combined_mask(aperture, points, grid=grid, weighting=weights), output, plot)


@app.command("points")
def points(
    file: Annotated[Path, typer.Argument(help="Points as .csv (x_mm, y_mm, perhaps weight), .npy (metres) or .json.")],
    aperture: Annotated[
        float | None, quantity_option(length, help="Side of the square aperture; not needed for .json.")
    ] = None,
    weights: Annotated[
        Weighting, typer.Option("--weights", help="analytic: those in the file, voronoi if none; voronoi; uniform.")
    ] = "analytic",
    output: Output = FILE,
    plot: Plot = None,
) -> None:
    """Take points from a file."""
    from steradian.masks import read_mask, with_weights

    mask = read_mask(file, aperture)
    _save_and_show(mask if weights == "analytic" else with_weights(mask, weights), output, plot)


@app.command("subset")
def subset(
    file: Annotated[Path, typer.Argument(help="The mask to take points from, e.g. that of a dense scan (.json).")],
    like: Annotated[Path | None, typer.Option(help="Keep the points nearest to those of this other mask.")] = None,
    every: Annotated[int | None, typer.Option(help="Keep every n-th point in the mask's order.")] = None,
    weights: Weights = "voronoi",
    output: Output = FILE,
    plot: Plot = None,
) -> None:
    """Subset of an existing mask's points: the points of a sparser scan."""
    from steradian.masks import nearest_points, read_mask, subset_mask

    mask = read_mask(file)
    if (like is None) == (every is None):
        raise InvalidInput("subset", "both or neither of --like and --every", "one of them")
    if every is not None and every < 1:
        raise InvalidInput("every", every, "at least 1")
    indices = nearest_points(mask, read_mask(like)) if like else tuple(range(0, mask.count, every or 1))
    _save_and_show(subset_mask(mask, indices, weighting=weights), output, plot, f"{len(indices)} of {mask.count}")


@app.command("show")
def show(
    file: Annotated[Path, typer.Argument(help="A mask file (.json).")],
    plot: Plot = None,
) -> None:
    """Print a mask's metrics."""
    from steradian.masks import read_mask

    mask = read_mask(file)
    _save_plot(mask, plot)
    show_figures("Mask", _figures(mask, f"{mask.count}"))
    finish_with_summary((f"mask of {mask.count:,} points", file), ("picture", plot))


app.command("compare")(mask_compare.compare)


def _grid(interval: float | None, count: int | None) -> ScannerGrid | None:
    from steradian.masks import ScannerGrid

    if (interval is None) != (count is None):
        raise InvalidInput("snap", "only one of --snap-interval and --snap-count", "both or neither")
    return None if interval is None else ScannerGrid.create(count=count, interval=interval)


def _point_of_interest(text: str) -> PointOfInterest:
    from steradian.masks import PointOfInterest

    parts = text.split(",")
    if len(parts) != 4 or not parts[3].strip().isdigit():
        raise InvalidInput("point", text, "x,y,depth,count such as 2mm,-1mm,3.6mm,800")
    x, y, depth = (length(part) for part in parts[:3])
    return PointOfInterest.create(offset=(x, y), depth=depth, count=int(parts[3]))


def _report_count(found: int, wanted: int | None, why: str) -> str:
    """Return the number of points as text, with the requested number and the reason if they differ."""
    return f"{found}" if wanted in (None, found) else f"{found} (asked {wanted}; {why})"


def _save_and_show(mask: Mask, output: Path, plot: Path | None, points: str = "") -> None:
    from steradian.masks import write_mask

    write_mask(mask, output)
    _save_plot(mask, plot)
    show_figures("Mask", _figures(mask, points or f"{mask.count}"))
    finish_with_summary((f"mask of {mask.count:,} points", output), ("picture", plot))


def _save_plot(mask: Mask, plot: Path | None) -> None:
    if plot is not None:
        from steradian.masks.plots import draw_mask

        draw_mask(mask, plot)


def _figures(mask: Mask, points: str) -> dict[str, object]:
    """Return the mask's metrics by name, for printing as a table."""
    from steradian.masks.metrics import evaluate_mask

    seen = evaluate_mask(mask)
    figures: dict[str, object] = {
        "points": points,
        "aperture": f"{1e3 * mask.aperture:g} mm",
        "spacing": f"{1e6 * seen.finest:.0f} to {1e6 * seen.coarsest:.0f} µm",
        "weight ratio": f"{mask.weight_ratio:.2f}",
        "sensed": f"{1e3 * mask.sensed_area:.4g} mm" if mask.is_line else f"{1e6 * mask.sensed_area:.4g} mm²",
    }
    if seen.opening_angle is not None and seen.largest_angle is not None:
        figures |= {
            "opening angle": f"{degrees(seen.opening_angle):.0f}°",
            "largest angle of incidence": f"{degrees(seen.largest_angle):.0f}°,"
            f" there the film loses about {seen.attenuation_db:.1f} dB at 1 MHz",
        }
    if seen.evenness is not None:
        figures["solid angle per point"] = f"varies by {100 * seen.evenness:.1f} % within the rim"
    return figures | {"id": mask.id}
