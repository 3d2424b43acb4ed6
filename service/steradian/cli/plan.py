"""``steradian plan``: create a scan plan and estimate its cost."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from steradian.cli.console import (
    console,
    duration,
    finish_with_summary,
    frequency,
    length,
    plot_option,
    quantity_option,
    show_figures,
    speed,
)
from steradian.cli.stage_options import EnoughOption, FocusOption, SurveyOption, plan_with_stages
from steradian.core.choices import VisitOrder
from steradian.core.exceptions import InvalidInput

METHOD_OF_FOCUS = (
    "a focus serves the direct method; the iterative one fits the whole field better with evenly spread points"
    " (correlation 0.993 against 0.982)"
)
"""Figures of docs/which-mask.md, vessels 2 mm deep and 500 points."""

if TYPE_CHECKING:
    from steradian.masks import Mask
    from steradian.plans import PlanCost, ScanPlan


def plan(
    mask: Annotated[Path, typer.Argument(help="A mask file, made by 'steradian mask'.")],
    pulse_rate: Annotated[float, quantity_option(frequency, "50Hz", help="Laser pulses per second.")] = 50.0,
    averages: Annotated[int, typer.Option(help="Pulses averaged into one A-line.")] = 1,
    samples: Annotated[int, typer.Option(help="Samples of an A-line.")] = 1024,
    sampling_interval: Annotated[float, quantity_option(duration, "8ns", help="Time between samples.")] = 8e-9,
    sound_speed: Annotated[float, quantity_option(speed, "1500m/s", help="Assumed speed of sound.")] = 1500.0,
    order: Annotated[
        VisitOrder | None,
        typer.Option(
            help="Order of the points. shortest: little travel; progressive: every stop leaves a usable sparse scan;"
            " bands: least time for moves and retunings together, needs --tuning or --wavelengths; wavelength: seldom"
            " retuned. Without it bands where --tuning is given, else snake."
        ),
    ] = None,
    tuning: Annotated[
        Path | None,
        typer.Option(
            help="Tuning map of the film: .npz of 'fabry-perot tune', .csv with x_mm, y_mm, wavelength_nm, .json,"
            " or a text matrix of wavelengths in nm with --tuning-pitch."
        ),
    ] = None,
    tuning_pitch: Annotated[
        float | None,
        quantity_option(
            length, help="Of a text matrix as tuning map: distance of its columns (along x) and rows (along y)."
        ),
    ] = None,
    max_sensitivity_loss: Annotated[
        float | None,
        typer.Option(
            help="Share of the film's sensitivity a point may lose to save a retuning. With --tuning 0.1, else none."
        ),
    ] = None,
    linewidth: Annotated[
        float, quantity_option(length, "500pm", help="Full width at half depth of the film's fringe (Lorentzian).")
    ] = 500e-12,
    retuning: Annotated[
        float, quantity_option(duration, "10ms", help="Time until the interrogation laser rests at a new wavelength.")
    ] = 10e-3,
    wavelengths: Annotated[
        Path | None, typer.Option(help="Bias wavelength of each point in nm: a .csv or .txt column or .npy.")
    ] = None,
    beams: Annotated[
        str,
        typer.Option(
            help="Interrogation beams of the scanner: 16 in a row, 4x4 in a rectangle, or a .csv with x_mm, y_mm of"
            " each beside the first. The mask is then measured where the beams can be."
        ),
    ] = "1",
    beam_spacing: Annotated[float, quantity_option(length, "800um", help="Between neighbouring beams.")] = 0.8e-3,
    places: Annotated[
        int | None, typer.Option(help="Places the beams are brought to; by default the mask's points over the beams.")
    ] = None,
    frames: Annotated[int, typer.Option(help="How often to measure the mask (at each excitation wavelength).")] = 1,
    excitation: Annotated[
        list[float] | None,
        quantity_option(length, help="Excitation wavelength, e.g. 700nm; repeat it for several, in order."),
    ] = None,
    blood_depth: Annotated[
        float | None,
        quantity_option(
            length, help="Depth of blood for the expected error of oxygen saturation; default: point of interest."
        ),
    ] = None,
    gate: Annotated[
        Literal["none", "frame", "point"],
        typer.Option(help="Unit that waits for an edge at the scanner's gate input (heart, breath, stimulus)."),
    ] = "none",
    gate_rate: Annotated[float, quantity_option(frequency, "1Hz", help="Expected edges, for the time.")] = 1.0,
    settling: Annotated[
        float, quantity_option(duration, "400us", help="Time the beam needs to rest after a move.")
    ] = 4e-4,
    beam_speed: Annotated[
        float, quantity_option(speed, "5m/s", "--speed", help="Speed of the beam on the film.")
    ] = 5.0,
    field: Annotated[float, quantity_option(length, "20mm", help="Side of the scanner's square field.")] = 20e-3,
    baud: Annotated[
        int, typer.Option(help="Baud rate of the serial line; 0 for a line that never limits.")
    ] = 12_000_000,
    resolution: Annotated[
        float | None, quantity_option(length, help="Required lateral resolution, for the aliasing warning.")
    ] = None,
    survey: SurveyOption = None,
    focus: FocusOption = None,
    enough: EnoughOption = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="The plan file to write (JSON).")] = Path("plan.json"),
    plot: Annotated[Path | None, plot_option("Also draw the way and where the time goes, e.g. plan.png.")] = None,
) -> None:
    """Create a plan from a mask and print its cost before any pulse.

    Errors refuse the plan (exit code 2, nothing written); warnings do not.
    """
    from steradian.masks import Mask, multi_beam_mask
    from steradian.masks.multi_beam import read_beams
    from steradian.plans import Fringe, Link, Motion, ScannerLimits, ScanPlan, Tuning, preview
    from steradian.plans.files import read_json, write_json

    over, pattern = read_json(Mask, mask), read_beams(beams, beam_spacing)
    if len(pattern) > 1:
        over = multi_beam_mask(over, pattern, places=places)
    made = ScanPlan.create(
        mask=over,
        pulse_rate=pulse_rate,
        averages=averages,
        samples=samples,
        sampling_interval=sampling_interval,
        sound_speed=sound_speed,
        order=order or (VisitOrder.SNAKE if tuning is None else VisitOrder.BANDS),
        **_wavelengths(over, tuning, tuning_pitch, wavelengths),
        max_sensitivity_loss=(0.0 if tuning is None else 0.1) if max_sensitivity_loss is None else max_sensitivity_loss,
        fringe=Fringe.create(linewidth=linewidth),
        tuning=Tuning.create(settling=retuning),
        beams=pattern if len(pattern) > 1 else (),
        frames=frames,
        gate=gate,
        gate_rate=gate_rate,
        excitation=tuple(excitation or ()),
        scanner=ScannerLimits.create(x=(-field / 2, field / 2), y=(-field / 2, field / 2)),
        motion=Motion.create(speed=beam_speed, settling=settling),
        link=Link.serial(baud) if baud else Link.create(byte_rate=None),
    )
    made = plan_with_stages(made, survey, focus, enough)
    output.parent.mkdir(parents=True, exist_ok=True)
    cost = preview(made, free_bytes=shutil.disk_usage(output.parent).free, resolution=resolution)
    if plot is not None:
        from steradian.plans.plots import draw_plan

        draw_plan(made, plot, cost)
    _show(made, cost, blood_depth)
    if cost.has_errors:
        raise InvalidInput("plan", "refused", "one without the errors listed")
    write_json(made, output)
    finish_with_summary((f"plan of {made.most_points:,} points", output), ("picture", plot))


def _show(made: ScanPlan, cost: PlanCost, blood_depth: float | None) -> None:
    parts = ", ".join(f"{part} {seconds:.3g}" for part, seconds in cost.seconds.items() if seconds)
    figures: dict[str, object] = {
        "points": _points(made),
        "time": f"{_time(cost)}, limited by the {cost.limiting}",
        "seconds by itself": parts,
        "travel": f"{1e3 * cost.travel:.0f} mm ({made.order})",
        "A-lines": f"{cost.bytes / 1e6:.1f} MB",
        "records reach": f"{1e3 * made.recording_depth:.2f} mm",
        "id": made.id,
    }
    if made.stages:
        figures["method"] = METHOD_OF_FOCUS
    if cost.beams > 1:
        off = {name: f"{1e6 * way:.0f} µm" for name, way in cost.displacement.items()}
        figures["beams"] = f"{cost.beams} at {len(made.beam_positions):,} places"
        if off:
            figures["points asked for"] = f"{off['median']} from a measured one (median), at most {off['largest']}"
    if made.frame_count > 1:
        figures["frames"] = made.frame_count
    if len(made.excitation) > 1:
        figures["oxygen saturation"] = _saturation(made, blood_depth)
    if cost.bands:
        figures["wavelengths"] = f"{cost.bands:,} set, {cost.retunings:,} retunings"
        loss = {name: f"{100 * share:.2g} %" for name, share in cost.sensitivity_loss.items()}
        said = f"at most {loss['max']}, mean {loss['mean']}"
        if made.wavelength_uncertainty:
            said += f"; {loss['expected']} with ±{1e12 * made.wavelength_uncertainty:.2g} pm of the map"
        figures["sensitivity lost"] = said
    if len(made.pass_ends) > 1:
        figures["usable after"] = ", ".join(f"{end:,}" for end in made.pass_ends) + " points"
    show_figures("Plan", figures)
    for finding in cost.findings:
        colour = "red" if finding.severity == "error" else "yellow"
        allowed = f" (allowed: {finding.allowed})" if finding.allowed else ""
        console().print(f"[{colour}]{finding.severity}[/] {finding.field}: {finding.message}{allowed}")


def _points(made: ScanPlan) -> str:
    if not made.stages:
        return str(made.mask.count)
    return f"{made.mask.count:,} of a survey, then at most {made.most_points - made.mask.count:,} focused on its image"


def _time(cost: PlanCost) -> str:
    """Return the time of a scan as text, a range where a stopping rule may end it early."""
    if cost.least_seconds is None or cost.least_seconds == cost.total_seconds:
        return f"{cost.total_seconds:.1f} s"
    return f"{cost.least_seconds:.1f} to {cost.total_seconds:.1f} s"


def _saturation(made: ScanPlan, depth: float | None) -> str:
    """Return the expected error of oxygen saturation with the plan's wavelengths, as text."""
    from steradian.plans import preview_excitation

    found = preview_excitation(made, depth=depth)
    if found.saturation_error is None:
        return f"not known: {found.reason}"
    return (
        f"± {found.saturation_error:.2g} of a voxel at {1e3 * found.depth:g} mm with noise of "
        f"{100 * found.noise:.2g} % of blood at the surface; condition {found.condition:.3g}"
    )


def _wavelengths(mask: Mask, tuning: Path | None, pitch: float | None, wavelengths: Path | None) -> dict[str, Any]:
    """Return the plan's fields for the optimum bias wavelengths, from a tuning map or a file of wavelengths."""
    from steradian.plans import TuningMap

    if tuning is not None and wavelengths is not None:
        raise InvalidInput("wavelengths", str(wavelengths), "nothing beside --tuning")
    if tuning is not None:
        return TuningMap.read(tuning, pitch=pitch).as_plan_fields(mask)
    return {"wavelengths": None if wavelengths is None else _read_wavelengths(wavelengths)}


def _read_wavelengths(path: Path) -> list[float]:
    """Read a file of bias wavelengths in nm and return them in metres."""
    import numpy as np

    from steradian.core.exceptions import DamagedFile, NotFound

    if not path.is_file():
        raise NotFound("file", str(path))
    try:
        values = (
            np.load(path, allow_pickle=False) if path.suffix == ".npy" else np.loadtxt(path, delimiter=",", ndmin=1)
        )
        return [float(value) * 1e-9 for value in np.asarray(values, dtype=np.float64).ravel()]
    except ValueError as error:
        raise DamagedFile(f"{path} is not a column of numbers: {error}") from error
