"""Unmixing of a stored series: volume files of chromophores and saturation, a picture and a report."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.reconstructions.pipeline.run import write_json
from steradian.reconstructions.series.alignment import ShiftReport, draw_shifts
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.series.maps import draw_saturation, write_maps
from steradian.reconstructions.series.series import Series
from steradian.scans.frames import SAME_LIGHT
from steradian.spectroscopy import (
    Chromophore,
    Fluence,
    TissueFluence,
    Unmixed,
    UnmixingPreset,
    fit_tissue_fluence,
    iterate_tissue_fluence,
)


@dataclass
class UnmixingReport:
    """Report of an unmixing, as written to ``report.json``."""

    chromophores: tuple[str, ...]
    wavelengths_m: tuple[float, ...]
    fluence: dict[str, Any]
    voxels: int
    misfit: float | None
    saturation: dict[str, float] = field(default_factory=dict)
    """Mean over voxels, weighted by total haemoglobin; its percentiles 5, 50 and 95; median standard error."""
    notes: tuple[str, ...] = ()
    shifts: tuple[ShiftReport, ...] = ()
    """Shift of each volume from the first one, where they were aligned."""


def unmix_series(series: Series, output: Path, preset: UnmixingPreset, **options: Any) -> UnmixingReport:
    """Unmix the means of a series at each wavelength and write the results into a folder.

    One volume file for each chromophore, ``saturation.h5``, ``saturation-error.h5`` and ``haemoglobin.h5`` (NaN where
    there is no signal), ``saturation.png`` and ``report.json``; options and errors are those of :func:`unmix_means`.
    """
    found, report = unmix_means(series, preset, **options)
    write_maps(found, output, {"unmixed": json.dumps(asdict(report))})
    if report.shifts:
        draw_shifts([SeriesFrame((n,)) for n in range(len(report.shifts))], report.shifts, output / "shifts.png")
    if found.saturation is not None and found.volume.dimensions == 3:
        draw_saturation(found, output / "saturation.png")
    write_json(output / "report.json", report)
    return report


def unmix_means(
    series: Series,
    preset: UnmixingPreset,
    *,
    own: tuple[Chromophore, ...] = (),
    fluence: Fluence | None = None,
    fit: bool = False,
    iterate: bool = False,
    align: bool = False,
    significance: float | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> tuple[Unmixed, UnmixingReport]:
    """Unmix the means of a series at each wavelength.

    Parameters
    ----------
    series
        Of at least as many wavelengths as chromophores.
    preset
        Chromophores and wavelengths.
    own
        Further chromophores, by spectra of the user's.
    fluence
        Model of the light; None: none, with a warning.
    fit
        Fit blood and saturation of the tissue, starting from ``fluence``, which must be a :class:`TissueFluence`.
    iterate
        Alternate unmixing and fluence by depth (:func:`steradian.spectroscopy.iterate_tissue_fluence`), starting from
        ``fluence``, which must be a :class:`TissueFluence`.
    align
        Move the object of each volume to its place in the first one (:meth:`.Series.aligned`).
    significance
        As of :func:`steradian.spectroscopy.unmix`; None: its default.
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Raises
    ------
    InvalidInput
        If wavelengths are not stated or too few, or a parameter does not fit.
    Cancelled
        If ``cancelled`` returned true.
    """
    if not series.wavelengths:
        raise InvalidInput("wavelengths", "not stated", "a series of a scan with excitation wavelengths")
    light = np.array(series.wavelengths)[preset.select(series.wavelengths)]
    near = [np.abs(light - frame.excitation).min() < SAME_LIGHT for frame in series.frames]
    part = series.part(np.flatnonzero(near).tolist())
    shifts: tuple[ShiftReport, ...] = ()
    if align:
        part, every = part.aligned()
        shifts = tuple(map(ShiftReport.of, every))
    notes: list[str] = []
    model = fluence
    if fit and iterate:
        raise InvalidInput("iterate", "true", "false with fit")
    if fit or iterate:
        model, note = _found_fluence(part, light.tolist(), preset.chromophores, fluence, own, iterate)
        notes.append(note)
    options = {} if significance is None else {"significance": significance}
    found = part.unmix(
        (*preset.chromophores, *own),
        fluence=model,
        non_negative=preset.non_negative,
        progress=progress,
        cancelled=cancelled,
        **options,
    )
    about = {"name": type(model).__name__, **asdict(model)} if isinstance(model, TissueFluence) else {}
    report = UnmixingReport(
        found.chromophores,
        tuple(map(float, light)),
        about or {"name": "none" if model is None else type(model).__name__},
        int(found.has_signal.sum()),
        found.misfit,
        _statistics(found),
        (*notes, *found.notes),
        shifts,
    )
    return found, report


def _found_fluence(
    part: Series,
    light: list[float],
    chromophores: tuple[str, ...],
    start: Fluence | None,
    own: tuple[Chromophore, ...],
    iterate: bool,
) -> tuple[Fluence, str]:
    """Return the fluence fitted to a series or iterated with its unmixing, and a note on it."""
    if not isinstance(start, TissueFluence):
        raise InvalidInput("fluence", type(start).__name__, "tissue, whose blood and saturation are found")
    if own:
        raise InvalidInput("chromophore", own[0].name, "one with a name, where the fluence is found")
    means = np.stack([part.at(each).mean().values for each in light])
    if iterate:
        found = iterate_tissue_fluence(means, light, part[0].axes, chromophores, start=start)
        ended = "converged" if found.converged else "not converged"
        change = found.changes[-1] if found.changes else float("nan")
        return (
            found.fluence,
            f"fluence iterated in {len(found.changes)} rounds, {ended}: last change of sO2 {change:.1g}",
        )
    fitted = fit_tissue_fluence(means, light, part[0].axes, chromophores, start=start)
    model, errors = fitted.fluence, fitted.standard_errors
    return model, (
        f"fitted tissue: blood {model.blood:.3g} ± {errors['blood']:.1g}, "
        f"saturation {model.saturation:.2f} ± {errors['saturation']:.1g}"
    )


def _statistics(found: Unmixed) -> dict[str, float]:
    if found.saturation is None or found.haemoglobin is None or found.saturation_error is None:
        return {}
    inside = np.isfinite(found.saturation)
    if not inside.any():
        return {}
    values, weights = found.saturation[inside], found.haemoglobin[inside]
    low, middle, high = np.percentile(values, [5, 50, 95])
    return {
        "mean": float(np.average(values, weights=weights)),
        "percentile_5": float(low),
        "median": float(middle),
        "percentile_95": float(high),
        "median_standard_error": float(np.median(found.saturation_error[inside])),
    }
