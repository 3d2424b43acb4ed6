"""``steradian unmix``: chromophores and oxygen saturation of a series of volumes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.console import finish_with_summary, format_files, progress_bar, show_figures, show_notes
from steradian.cli.frame_options import AlignOption
from steradian.core.exceptions import InvalidInput

TISSUE = "The tissue around"


def unmix(
    series: Annotated[Path, typer.Argument(help="A series file, or the folder of a reconstruction of several frames.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")] = Path("unmixed"),
    chromophore: Annotated[
        list[str] | None,
        typer.Option(
            help="Chromophore beside both haemoglobins: water, lipid, melanin, ICG, or a CSV file of nm and 1/(cm·M)."
        ),
    ] = None,
    preset: Annotated[
        Path | None, typer.Option(help="Unmixing preset of PATATO (JSON), instead of chromophores.")
    ] = None,
    fluence: Annotated[
        str,
        typer.Option(
            help="Light at a depth: none (with a warning), uniform, tissue as stated, fit (that tissue to the series),"
            " iterate (its blood by depth from the unmixing), or a map: a file in .h5, .nii or .nii.gz."
        ),
    ] = "none",
    blood: Annotated[float, typer.Option(help="Volume fraction of blood.", rich_help_panel=TISSUE)] = 0.02,
    saturation: Annotated[float, typer.Option(help="Oxygen saturation of that blood.", rich_help_panel=TISSUE)] = 0.7,
    water: Annotated[float, typer.Option(help="Volume fraction of water.", rich_help_panel=TISSUE)] = 0.65,
    lipid: Annotated[float, typer.Option(help="Volume fraction of lipid.", rich_help_panel=TISSUE)] = 0.1,
    scattering: Annotated[
        float, typer.Option(help="Reduced scattering at 500 nm in 1/m.", rich_help_panel=TISSUE)
    ] = 2000.0,
    align: AlignOption = False,
    significance: Annotated[
        float, typer.Option(help="Height above the background, in standard deviations, from which a voxel has a value.")
    ] = 6.0,
) -> None:
    """Unmix a series into chromophores; write volumes, a picture of oxygen saturation, and a report."""
    import steradian
    from steradian.reconstructions.fluence_file import SUFFIXES, read_fluence_map
    from steradian.reconstructions.series.series import Series
    from steradian.reconstructions.series.unmixing import unmix_series
    from steradian.spectroscopy import (
        CHROMOPHORES,
        Fluence,
        TissueFluence,
        UniformFluence,
        UnmixingPreset,
        read_chromophore,
        read_patato_preset,
    )

    found = steradian.open(series)
    if not isinstance(found, Series):
        raise InvalidInput("series", str(series), "a series (series.h5), of a scan with several wavelengths")
    if preset is not None and chromophore:
        raise InvalidInput("preset", preset.name, "none beside chromophores")
    names = [name for name in chromophore or () if not name.lower().endswith(".csv")]
    own = tuple(read_chromophore(Path(name)) for name in chromophore or () if name.lower().endswith(".csv"))
    for name in names:
        if name not in CHROMOPHORES:
            raise InvalidInput("chromophore", name, f"{', '.join(CHROMOPHORES)}, or a CSV file")
    wanted = UnmixingPreset(("oxyhaemoglobin", "deoxyhaemoglobin", *names))
    if preset is not None:
        wanted = read_patato_preset(preset)
    tissue = TissueFluence(blood, saturation, water, lipid, scattering)
    models = {"none": None, "uniform": UniformFluence(), "tissue": tissue, "fit": tissue, "iterate": tissue}
    model: Fluence | None
    if fluence in models:
        model = models[fluence]
    elif Path(fluence).suffix.lower() in SUFFIXES:
        model = read_fluence_map(fluence)
    else:
        raise InvalidInput("fluence", fluence, f"{', '.join(models)}, or a file in {', '.join(SUFFIXES)}")
    with progress_bar() as progress:
        report = unmix_series(
            found,
            output,
            wanted,
            own=own,
            fluence=model,
            fit=fluence == "fit",
            iterate=fluence == "iterate",
            align=align,
            significance=significance,
            progress=progress,
        )
    figures = {
        "chromophores": ", ".join(report.chromophores),
        "wavelengths": ", ".join(f"{1e9 * each:g}" for each in report.wavelengths_m) + " nm",
        "voxels with signal": f"{report.voxels:,}",
    }
    if report.saturation:
        of = report.saturation
        figures["saturation"] = (
            f"mean {of['mean']:.3f}, 5 to 95 %: {of['percentile_5']:.2f} to {of['percentile_95']:.2f}, "
            f"of a voxel ± {of['median_standard_error']:.2g}"
        )
    if report.misfit is not None:
        figures["misfit"] = f"{report.misfit:.2g} of the background's variance"
    show_figures("Unmixing", figures | {"files": format_files(output)})
    show_notes(report.notes)
    finish_with_summary(("all results", output))
