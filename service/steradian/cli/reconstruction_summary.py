"""Terminal summary of a reconstruction's report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from steradian.cli.console import console, finish_with_summary, format_files, show_figures, show_notes

if TYPE_CHECKING:
    from steradian.reconstructions.pipeline.motion import MotionReport
    from steradian.reconstructions.pipeline.report import Report
    from steradian.reconstructions.series.report import SeriesReport


def show_report(report: Report, output: Path) -> None:
    """Print a reconstruction's summary and output files."""
    spacing = " × ".join(f"{1e6 * step:.4g}" for step in report.spacing_m)
    figures = {
        "sensors": f"{report.sensors} of {report.planned}",
        "left out": ", ".join(f"{count} {flag}" for flag, count in report.shots.left_out.items()) or "none",
        "volume": " × ".join(map(str, report.shape)) + f" ({report.axes}), {spacing} µm",
        "pictures": f"from {1e3 * max(report.near_field_m, report.origin_m[-1]):.2f} mm depth, colours to the "
        f"{report.scale_percentile:g}th percentile",
        **_fit(report),
        **_band(report),
        **_motion([report.motion]),
        **_uncertainty(report),
        **_medium(report),
        "sensed": _area(report),
        "seconds": ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in report.seconds.items()),
        "files": format_files(output),
    }
    show_figures("Reconstruction", figures)
    show_notes(report.notes)
    if report.missing is not None:
        console().print(f"[yellow]warning[/]: {report.missing}", soft_wrap=True)
    finish_with_summary(("volume", output / "volume.h5"), ("all results", output))


def show_series_report(report: SeriesReport, output: Path) -> None:
    """Print the summary of a series and its output files."""
    spacing = " × ".join(f"{1e6 * step:.4g}" for step in report.spacing_m)
    light: dict[float, int] = {}
    for frame in report.frames:
        light[frame.excitation_m] = light.get(frame.excitation_m, 0) + 1
    figures = {
        "series": ", ".join(
            f"{count} at {1e9 * each:g} nm" if each else f"{count} volumes" for each, count in light.items()
        ),
        "volumes": " × ".join(map(str, report.shape)) + f" ({report.axes}), {spacing} µm",
        "sensors": ", ".join(sorted({f"{frame.sensors} of {frame.planned}" for frame in report.frames})),
        "sound speed": f"{report.sound_speed_m_s:g} m/s",
        **_shifts(report),
        **_motion([frame.motion for frame in report.frames]),
        "seconds": ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in report.seconds.items()),
        "files": format_files(output),
    }
    show_figures("Series", figures)
    show_notes(tuple(dict.fromkeys((*report.notes, *(note for frame in report.frames for note in frame.notes)))))
    finish_with_summary(("series", output / "series.h5"), ("all results", output))


def _medium(report: Report) -> dict[str, object]:
    """Return table rows on the medium: its speed of sound, or its layers and the noise gain of the compensation."""
    layers: Any = report.parameters.get("medium")
    if not layers:
        return {"sound speed": f"{report.sound_speed_m_s:g} m/s"}
    from steradian.reconstructions.medium_parameters import LayerParameters, build_medium

    rows: dict[str, object] = {"medium": build_medium([LayerParameters.create(**layer) for layer in layers])}
    if report.noise_gain:
        shown = report.noise_gain[:: max(1, len(report.noise_gain) - 1)]
        rows["noise gain"] = ", ".join(f"{gain:.2g} at {1e3 * depth:.3g} mm" for depth, gain in shown)
    return rows


def _motion(found: list[MotionReport | None]) -> dict[str, object]:
    """Return a table row on the motion within scans; empty where it was not looked for."""
    texts = []
    for each in found:
        if each is not None:
            pairs = zip("xyz", each.rms_m, each.standard_error_m, strict=True)
            text = ", ".join(f"{axis} {1e6 * rms:.2g} ± {1e6 * error:.2g} µm" for axis, rms, error in pairs)
            texts.append(f"{text} ({'undone' if each.corrected else 'not significant'})")
    return {"motion (rms)": "; ".join(texts)} if texts else {}


def _uncertainty(report: Report) -> dict[str, object]:
    """Return a table row on the standard errors; empty where they were not asked for."""
    found = report.uncertainty
    if found is None:
        return {}
    share = f"{100 * found.above_three:.2g} % of the voxels exceed three of them"
    return {"standard errors": f"median {found.median:.3g}, {share}, in {found.file}"}


def _shifts(report: SeriesReport) -> dict[str, object]:
    """Return a table row on the shifts between the volumes of a series; empty where they were not looked for."""
    shifts = [frame.shift for frame in report.frames if frame.shift is not None]
    if not shifts:
        return {}
    largest = max(max(map(abs, shift.metres)) for shift in shifts)
    undone = sum(shift.corrected for shift in shifts)
    return {"shifts": f"{undone} of {len(report.frames)} volumes moved back, at most {1e6 * largest:.3g} µm"}


def _area(report: Report) -> str:
    if report.sensed_area_m2 is None:
        return "weights play no part"
    area = report.sensed_area_m2
    return f"{1e3 * area:.4g} mm" if len(report.shape) == 2 else f"{1e6 * area:.4g} mm²"


def _band(report: Report) -> dict[str, object]:
    """Return a table row on the excluded frequency band; empty if no band was excluded."""
    if report.band is None:
        return {}
    end = 1e-6 * report.band.highest_frequency_hz
    return {"frequencies": f"below {end:.4g} MHz; {100 * report.band.left_out:.2g} % of the A-lines' power left out"}


def _fit(report: Report) -> dict[str, object]:
    """Return table rows on the iterative fit: number of iterations, stop reason and misfit; empty for other methods."""
    if report.fit is None:
        return {}
    why = {
        "discrepancy": "the noise is reached",
        "change": "the image no longer changes",
        "misfit": "another step would not pay",
        "iterations": "as many as asked",
    }
    return {
        "iterations": f"{report.fit.iterations} ({why[report.fit.stopped]})",
        "products with the model, or direct reconstructions": report.fit.products,
        "misfit": f"{100 * report.fit.misfit:.2g} % of the A-lines, in the band that holds signal",
    }
