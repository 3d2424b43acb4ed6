"""``steradian design``: points × averages for a number of laser pulses and a vessel."""

from __future__ import annotations

import json
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from steradian.cli.console import (
    console,
    duration,
    finish_with_summary,
    frequency,
    length,
    plot_option,
    progress_bar,
    quantity_option,
    show_figures,
    show_notes,
    speed,
)
from steradian.cli.scan_time import scan_time
from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.comparisons.design_result import PulseSplit, ScanDesign
    from steradian.quality.pulse_noise import PulseNoise

NOISE_PANEL = "Noise of one pulse (one of the two)"
PULSES_PANEL = "Pulses (one of the two)"


def design(
    depth: Annotated[float, quantity_option(length, help="Distance of the vessel from the film, e.g. 2.5mm.")],
    vessel: Annotated[float, quantity_option(length, help="Diameter of the vessel, e.g. 150um.")],
    time: Annotated[
        float | None,
        quantity_option(scan_time, help="Duration of the scan, e.g. 15min or 90s.", rich_help_panel=PULSES_PANEL),
    ] = None,
    pulses: Annotated[
        int | None, typer.Option(help="Number of laser pulses, instead of --time.", rich_help_panel=PULSES_PANEL)
    ] = None,
    noise_from: Annotated[
        Path | None,
        typer.Option(
            help="Measure it in this scan of a similar object: its strongest A-lines count as those of the vessel.",
            rich_help_panel=NOISE_PANEL,
        ),
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            help="Peak of the strongest A-line over the noise's standard deviation, in dB.", rich_help_panel=NOISE_PANEL
        ),
    ] = None,
    pulse_rate: Annotated[float, quantity_option(frequency, "50Hz", help="Laser pulses per second.")] = 50.0,
    aperture: Annotated[float, quantity_option(length, "13.56mm", help="Side of the square aperture.")] = 13.56e-3,
    offset_x: Annotated[float, quantity_option(length, help="Vessel along x from the centre.")] = 0.0,
    offset_y: Annotated[float, quantity_option(length, help="The same along y.")] = 0.0,
    arrangement: Annotated[
        list[str] | None,
        typer.Option(
            help="Arrangement to try; repeat it for several. Default: equi-steradian, grid, hexagonal, poisson-disc."
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(help="direct (a minute) or iterative (several); repeat it for both. Default: both."),
    ] = None,
    averages: Annotated[
        list[int] | None, typer.Option(help="Averages to try; repeat it for several. Default: powers of two.")
    ] = None,
    max_points: Annotated[int, typer.Option(help="Leave out splits of more points.")] = 20_000,
    modes: Annotated[int | None, typer.Option(help="Lateral modes of the image; default: of 60 um.")] = None,
    sampling_interval: Annotated[
        float | None,
        quantity_option(duration, help="Time between samples; default: that of --noise-from, else 8ns."),
    ] = None,
    sound_speed: Annotated[
        float | None, quantity_option(speed, help="Speed of sound; default: that of --noise-from, else 1500m/s.")
    ] = None,
    all_splits: Annotated[bool, typer.Option("--all", help="Print all splits, not only the proposed ones.")] = False,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the mask of the best proposal, e.g. mask.json.")
    ] = None,
    plan: Annotated[Path | None, typer.Option(help="Write its plan, e.g. plan.json, ready for 'scan run'.")] = None,
    plot: Annotated[Path | None, plot_option("Draw contrast and width over the points, e.g. design.png.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print all figures as JSON instead of a table.")] = False,
) -> None:
    """Split laser pulses between points and averages, with the expected image of a vessel for each split.

    Proposes the fewest points whose contrast is within 1 dB of the highest, for each arrangement, for the direct and
    the iterative method. The sensor is ideal and the vessel alone.
    """
    from steradian.comparisons.scan_design import ARRANGEMENTS, design_scan

    measured, dt, c = _noise(noise, noise_from)
    with progress_bar() as progress:
        found = design_scan(
            depth=depth,
            vessel=vessel,
            noise=measured,
            time=time,
            pulses=pulses,
            pulse_rate=pulse_rate,
            aperture=aperture,
            offset=(offset_x, offset_y),
            arrangements=tuple(arrangement or ARRANGEMENTS),  # type: ignore[arg-type]
            methods=tuple(method or ("direct", "iterative")),  # type: ignore[arg-type]
            averages=averages or None,
            max_points=max_points,
            modes=modes,
            sampling_interval=dt if sampling_interval is None else sampling_interval,
            sound_speed=c if sound_speed is None else sound_speed,
            progress=progress,
        )
    if as_json:
        typer.echo(json.dumps(found.as_json(), indent=2))
    else:
        _show(found, all_splits=all_splits)
    _write(found, output, plan, plot, quiet=as_json)


def _noise(noise: float | None, noise_from: Path | None) -> tuple[PulseNoise | float, float, float]:
    """Return the noise of one pulse, the sampling interval and the sound speed."""
    if (noise is None) == (noise_from is None):
        raise InvalidInput("noise", "both or neither of --noise and --noise-from", "one of the two")
    if noise is not None:
        return noise, 8e-9, 1500.0
    from steradian.scans.pulse_noise import read_pulse_noise

    assert noise_from is not None  # noqa: S101 - one of the two
    found = read_pulse_noise(noise_from)
    return found.noise, found.sampling_interval, found.sound_speed or 1500.0


def _write(found: ScanDesign, output: Path | None, plan: Path | None, plot: Path | None, *, quiet: bool) -> None:
    from steradian.masks import write_mask
    from steradian.plans.files import write_json

    chosen = found.chosen
    if (output or plan) and chosen is None:
        raise InvalidInput("pulses", found.pulses, "more: the vessel does not show in any split")
    if chosen is not None and output is not None:
        output.parent.mkdir(parents=True, exist_ok=True)
        write_mask(chosen.plan.mask, output)
    if chosen is not None and plan is not None:
        plan.parent.mkdir(parents=True, exist_ok=True)
        write_json(chosen.plan, plan)
    if plot is not None:
        found.save(plot)
    written = [("mask", output), ("plan", plan), ("picture", plot)]
    if not quiet and any(path for _, path in written):
        finish_with_summary(*written)


def _show(found: ScanDesign, *, all_splits: bool) -> None:
    micrometres, deep = f"{1e6 * found.diameter:.4g} µm", f"{1e3 * found.place[2]:.4g} mm"
    title = f"{found.pulses:,} pulses, one of {found.noise.decibels:.1f} dB: a vessel of {micrometres}, {deep} deep"
    table = Table(title=title, title_justify="left", title_style="bold", box=None)
    for name in ("arrangement", "method"):
        table.add_column(name, style="cyan", no_wrap=True)
    for name in ("points", "averages", "time", "contrast", "without noise", "width", "scatter", "thin line"):
        table.add_column(name, justify="right", no_wrap=True)
    for arrangement in found.arrangements:
        for method in found.methods:
            proposed = found.proposal(arrangement, method)
            for split in found.of(arrangement, method):
                if all_splits or split is proposed:
                    table.add_row(*_row(found, split), style="bold" if all_splits and split is proposed else None)
    console().print(table, "")
    figures: dict[str, object] = {}
    for method in found.methods:
        best = found.best(method)
        figures[method] = "the vessel shows in no split: more pulses are needed" if best is None else _said(best)
    show_figures("Proposed", figures)
    notes = [
        f"{method}: the width scatters by more than 5 %: more pulses would tell it"
        for method in found.methods
        if (best := found.best(method)) is not None and not best.usable
    ]
    show_notes(notes)


def _row(found: ScanDesign, split: PulseSplit) -> list[str]:
    from steradian.comparisons.vessel_image import MAX_CONTRAST_DB

    told = split.expected
    capped = split.method == "iterative" and told.contrast_db >= MAX_CONTRAST_DB
    return [
        split.arrangement,
        split.method,
        f"{split.points:,}",
        f"{split.averages:,}",
        f"{split.seconds:.1f} s",
        f"> {told.contrast_db:.0f} dB" if capped else f"{told.contrast_db:.1f} dB",
        "" if split.method == "iterative" else f"{told.side_lobes_db:.1f} dB",
        f"{1e6 * told.width:.0f} µm",
        f"{100 * told.width_scatter:.1f} %",
        f"{1e6 * told.resolution:.0f} µm" if isfinite(told.resolution) else "",
    ]


def _said(split: PulseSplit) -> str:
    return f"{split.arrangement}, {split.points:,} points × {split.averages:,} averages, {split.seconds:.1f} s"
