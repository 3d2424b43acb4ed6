"""``steradian what-if``: reconstruct a full scan from the subset of A-lines in a sparse mask (undersampling)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from steradian.cli.console import (
    finish_with_summary,
    format_files,
    length,
    progress_bar,
    quantity_option,
    show_figures,
    show_notes,
    speed,
)
from steradian.cli.frame_options import AverageOption, FrameOption, WavelengthOption
from steradian.cli.medium_options import AttenuationOption, LayerOption, parse_medium


def what_if(
    file: Annotated[Path, typer.Argument(help="A finished dense scan: a scan file or another known recording.")],
    output: Annotated[Path, typer.Argument(help="Folder for the results.")] = Path("what-if"),
    mask: Annotated[Path, typer.Option(help="A mask file, made by 'steradian mask'.")] = Path("mask.json"),
    points: Annotated[
        str, typer.Option(help="nearest: the point measured nearest to each of the mask's; exact: the same points.")
    ] = "nearest",
    modes: Annotated[int | None, typer.Option(help="Lateral modes per axis; default: as the scan suggests.")] = None,
    weights: Annotated[str, typer.Option(help="Of the image through the mask: mask, uniform or voronoi.")] = "mask",
    sound_speed: Annotated[float | None, quantity_option(speed, help="Speed of sound; default: the scan's.")] = None,
    layer: LayerOption = None,
    attenuation: AttenuationOption = None,
    diameter: Annotated[
        float | None,
        quantity_option(length, help="Compare within this disc around the point of interest; default: 45° wide."),
    ] = None,
    threshold: Annotated[float, typer.Option(help="Pixels count from this share of the full image's maximum.")] = 0.04,
    frame: FrameOption = None,
    wavelength: WavelengthOption = None,
    average: AverageOption = False,
) -> None:
    """Reconstruct a dense scan through a sparse mask, and compare with the image of all its A-lines."""
    from steradian.masks import Mask
    from steradian.plans.files import read_json
    from steradian.reconstructions.parameters import ReconstructionParameters
    from steradian.reconstructions.studies.what_if import compare_subset as run
    from steradian.scans.frames import FrameChoice

    medium = parse_medium(layer, attenuation, sound_speed)
    parameters = ReconstructionParameters.create(modes=modes, weights=weights, **medium)
    chosen: Any = points
    with progress_bar() as progress:
        report = run(
            file,
            read_json(Mask, mask),
            output,
            parameters,
            points=chosen,
            diameter=diameter,
            threshold=threshold,
            frame=FrameChoice(frame, wavelength, average),
            progress=progress,
        )
    within = "everywhere" if report.diameter_m is None else f"in a disc of {1e3 * report.diameter_m:.4g} mm"
    moved = report.displacement_m
    figures: dict[str, object] = {
        "A-lines": f"{report.used} of {report.scan_points} ({100 * report.share:.3g} %)",
        "points of the mask": f"{report.asked}, {report.merged} merged with others",
        "displacement": f"{1e6 * moved['rms']:.4g} µm rms, {1e6 * moved['largest']:.4g} µm at most",
        "compared": f"{within}, from {100 * report.threshold:g} % of the maximum",
    }
    for name, value in report.quality.items():
        figures[name.replace("_", " ")] = "undefined" if value is None else f"{value:.4g}"
    figures["pulses saved"] = f"{100 * report.saved['scan_share']:.3g} %"
    figures["files"] = format_files(output)
    show_figures("What if", figures)
    show_notes(report.notes)
    finish_with_summary(("both images and their comparison", output))
