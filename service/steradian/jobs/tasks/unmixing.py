"""Unmixing job: maps of chromophores and oxygen saturation of a stored series, as a series of their own."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import Progress
from steradian.jobs.unmixing_request import UnmixingOptions
from steradian.reconstructions.pipeline.run import write_json
from steradian.reconstructions.series.file import read_metadata
from steradian.reconstructions.series.maps import MapReport, draw_saturation, write_map_series
from steradian.reconstructions.series.series import read_series
from steradian.reconstructions.series.unmixing import unmix_means
from steradian.spectroscopy import CHROMOPHORES, Chromophore, TissueFluence, UniformFluence, UnmixingPreset


def unmix_stored(file: Path, output: Path, options: UnmixingOptions, identifier: str, progress: Progress) -> MapReport:
    """Unmix a series file and write ``series.h5`` with a frame for each map, a picture and ``report.json``.

    Parameters
    ----------
    file
        The series.
    output
        Folder for the results.
    options
        Chromophores, wavelengths and light.
    identifier
        Identifier of the series, for the provenance.
    progress
        See :mod:`steradian.core.progress`.

    Raises
    ------
    InvalidInput
        When an option does not fit the series.
    """
    began = time.perf_counter()
    own = [Chromophore(each.name, each.wavelengths, each.absorption, "unit") for each in options.spectra]  # type: ignore[arg-type]
    names = {each.name for each in own}
    for name in options.chromophores:
        if name not in CHROMOPHORES and name not in names:
            raise InvalidInput("unmixing.chromophores", name, ", ".join((*CHROMOPHORES, "or the name of a spectrum")))
    preset = UnmixingPreset(
        tuple(name for name in options.chromophores if name not in names),
        options.wavelengths,
        non_negative=options.non_negative,
    )
    light = options.fluence.model_dump(exclude={"model"})
    tissue = TissueFluence(**light)
    models = {"none": None, "uniform": UniformFluence(), "tissue": tissue, "fit": tissue, "iterate": tissue}
    found, unmixed = unmix_means(
        read_series(file),
        preset,
        own=tuple(own),
        fluence=models[options.fluence.model],
        fit=options.fluence.model == "fit",
        iterate=options.fluence.model == "iterate",
        significance=options.significance,
        progress=progress,
    )
    progress("writing", 0, 1)
    about = read_metadata(file)
    frames = write_map_series(found, output / "series.h5", about, {"reconstruction": identifier})
    files = ["series.h5", "report.json"]
    if found.saturation is not None and found.volume.dimensions == 3:
        draw_saturation(found, output / "mip-z.png")
        files.append("mip-z.png")
    report = MapReport.of(found.volume, about, frames, asdict(unmixed), tuple(unmixed.notes))
    report.files, report.seconds = files, {"unmix": round(time.perf_counter() - began, 3)}
    write_json(output / "report.json", report)
    return report
