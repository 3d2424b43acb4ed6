"""``steradian reconstruct``: from A-lines to a volume."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.console import length, progress_bar, show_figures


def reconstruct(
    file: Annotated[Path, typer.Argument(help="A scan file, or a k-Wave recording (.npz with p, dt and dx).")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")] = Path("reconstruction"),
    method: Annotated[
        str, typer.Option(help="nedner, ner, linear or interpolated; nedner uses NER where the sensors allow it.")
    ] = "nedner",
    modes: Annotated[int | None, typer.Option(help="Lateral modes per axis; default: as the scan suggests.")] = None,
    upsampling: Annotated[int, typer.Option(help="Sinc interpolation of the finished image, times.")] = 1,
    sound_speed: Annotated[float | None, typer.Option(help="Speed of sound in m/s; default: the scan's.")] = None,
    first_depth: Annotated[
        float | None, typer.Option(parser=length, metavar="LENGTH", help="Compute only from here on.")
    ] = None,
    last_depth: Annotated[
        float | None, typer.Option(parser=length, metavar="LENGTH", help="Compute only to here.")
    ] = None,
    weights: Annotated[str, typer.Option(help="mask (its own), uniform or voronoi.")] = "mask",
    tolerance: Annotated[float, typer.Option(help="Wanted relative error of the transforms.")] = 1e-4,
) -> None:
    """Reconstruct the initial pressure and write the volume, its projections and a report into a folder."""
    from steradian.reconstructions.job import reconstruct_scan
    from steradian.reconstructions.parameters import ReconstructionParameters

    parameters = ReconstructionParameters.create(
        method=method,
        modes=modes,
        upsampling=upsampling,
        sound_speed=sound_speed,
        depth_range=None if first_depth is None and last_depth is None else (first_depth or 0.0, last_depth or 1.0),
        weights=weights,
        tolerance=tolerance,
    )
    with progress_bar() as progress:
        report = reconstruct_scan(file, output, parameters, progress=progress)
    spacing = " × ".join(f"{1e6 * step:.4g}" for step in report.spacing_m)
    figures = {
        "sensors": f"{report.sensors} of {report.planned}",
        "volume": " × ".join(map(str, report.shape)) + f" (x, y, z), {spacing} µm",
        "sound speed": f"{report.sound_speed_m_s:g} m/s",
        "seconds": ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in report.seconds.items()),
        "folder": f"{output} (volume.h5, mip-x.png, mip-y.png, mip-z.png, report.json)",
    }
    show_figures("Reconstruction", figures)
