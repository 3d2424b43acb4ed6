"""``steradian what-if``: reconstruct a full scan from the subset of A-lines in a sparse mask (undersampling)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final

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

_MEANINGS: Final = {
    "mip_x_correlation": ("correlation along x", "of the projections, where the full image is above the threshold"),
    "mip_y_correlation": ("correlation along y", "the same along y"),
    "mip_z_correlation": ("correlation along z", "the same along z"),
    "volume_correlation": ("correlation", "of all voxels of the disc: artefacts beside the object lower it"),
    "volume_correlation_of_interest": (
        "correlation at the object",
        "of the voxels above the threshold: only changes of the object itself lower it",
    ),
    "volume_error": ("error", "norm of the difference over the full image's, after the best factor; 0: equal"),
    "volume_amplitude": ("amplitude", "values over those of the full image; 1: equal"),
}
"""Name on the terminal and meaning of each figure of a comparison in three dimensions."""


def what_if(
    file: Annotated[Path, typer.Argument(help="A finished dense scan: a scan file or another known recording.")],
    output: Annotated[Path, typer.Argument(help="Folder for the results.")] = Path("what-if"),
    mask: Annotated[Path, typer.Option(help="A mask file, made by 'steradian mask'.")] = Path("mask.json"),
    points: Annotated[
        str, typer.Option(help="nearest: the point measured nearest to each of the mask's; exact: the same points.")
    ] = "nearest",
    method: Annotated[
        str, typer.Option(help="Of both images, as in 'reconstruct': nedner, …; iterative, where masks differ least.")
    ] = "nedner",
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
    """Reconstruct a dense scan through a sparse mask, and compare with the image of all its A-lines.

    Correlations are 1 where both images are alike up to a factor, 0 where they have nothing in common.
    """
    from steradian.masks import Mask
    from steradian.plans.files import read_json
    from steradian.reconstructions.parameters import ReconstructionParameters
    from steradian.reconstructions.studies.what_if import compare_subset as run
    from steradian.scans.frames import FrameChoice

    medium = parse_medium(layer, attenuation, sound_speed)
    parameters = ReconstructionParameters.create(method=method, modes=modes, weights=weights, **medium)
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
        "method": parameters.method,
        "compared": f"{within}, from {100 * report.threshold:g} % of the maximum",
    }
    for name, value in report.quality.items():
        label, meaning = _MEANINGS[name.replace("image_", "volume_")]
        figures[label] = f"{'undefined' if value is None else f'{value:.3f}'}, {meaning}"
    figures["pulses saved"] = f"{100 * report.saved['scan_share']:.3g} %"
    figures["files"] = format_files(output)
    show_figures("What if", figures)
    show_notes(report.notes)
    finish_with_summary(("both images and their comparison", output))
