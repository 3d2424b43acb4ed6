"""``steradian reconstruct``: reconstruct a volume from a scan's A-lines."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from steradian.cli.console import (
    Quantity,
    duration,
    frequency,
    length,
    progress_bar,
    quantity_option,
    speed,
)
from steradian.cli.frame_options import AlignOption, AverageOption, FrameOption, MotionOption, WavelengthOption
from steradian.cli.import_ import DescriptionOption, parse_description
from steradian.cli.medium_options import AttenuationOption, LayerOption, parse_medium
from steradian.cli.reconstruction_summary import show_report, show_series_report
from steradian.cli.subset_options import SuppressOption, UncertaintyOption, parse_subsets, refuse_series
from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.reconstructions.parameters import ReconstructionParameters
    from steradian.reconstructions.pipeline.report import Report
    from steradian.reconstructions.pipeline.size_limit import LargeVolume
    from steradian.reconstructions.series.report import SeriesReport

CONDITIONING, DISPLAY = "Preprocessing", "Image display"
SHOTS = "Shot normalisation"
FOLLOWING = "A scan that is still running"
ITERATIVE, FILM = "With the method iterative", "The sensor's response"


def _option(text: str, panel: str | None = None, kind: Quantity | None = None, default: str | None = None) -> Any:
    if kind is None:
        return typer.Option(help=text, rich_help_panel=panel)
    return quantity_option(kind, default, help=text, rich_help_panel=panel)


def reconstruct(
    file: Annotated[
        Path,
        typer.Argument(
            help="A scan file, or a recording: .sgl and k-Wave (.npz with p, dt, dx) as they are, others with -d."
        ),
    ],
    description: DescriptionOption = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")] = Path("reconstruction"),
    method: Annotated[
        str,
        typer.Option(help="nedner (NER where the sensors allow it), ner, linear, nearest, interpolated; iterative."),
    ] = "nedner",
    frame: FrameOption = None,
    wavelength: WavelengthOption = None,
    average: AverageOption = False,
    align: AlignOption = False,
    motion: MotionOption = False,
    uncertainty: UncertaintyOption = False,
    suppress_artefacts: SuppressOption = False,
    modes: Annotated[int | None, typer.Option(help="Lateral modes per axis; default: as the scan suggests.")] = None,
    upsampling: Annotated[int, typer.Option(help="Sinc interpolation of the finished image, times.")] = 1,
    sound_speed: Annotated[float | None, _option("Speed of sound; default: the scan's.", kind=speed)] = None,
    layer: LayerOption = None,
    attenuation: AttenuationOption = None,
    first_depth: Annotated[
        float | None, _option("Compute only from here on; default: 0, or where a late record begins.", kind=length)
    ] = None,
    last_depth: Annotated[
        float | None, _option("Compute only to here; default: where the record ends.", kind=length)
    ] = None,
    weights: Annotated[str, typer.Option(help="mask (its own), uniform or voronoi.")] = "mask",
    tolerance: Annotated[float, typer.Option(help="Relative error of the transforms.")] = 1e-4,
    window: Annotated[str, typer.Option(help="kaiser-bessel or semicircle.")] = "kaiser-bessel",
    time_padding: Annotated[float, typer.Option(help="Extend the record with zeros, times.")] = 1.0,
    lateral_padding: Annotated[
        float | None, typer.Option(help="Extend the aperture with zeros, times; default: 1, for iterative as it needs.")
    ] = None,
    highest_frequency: Annotated[
        Any,
        typer.Option(
            parser=_frequency_or_signal,
            metavar="<frequency>|signal",
            help="Leave out what is above, 20MHz, at about its share of the cost; signal: found.",
        ),
    ] = None,
    depth_step: Annotated[
        float | None, _option("Distance of slices, at most; default: as the highest frequency allows.", kind=length)
    ] = None,
    device: Annotated[str, typer.Option(help="auto (a GPU, where there is one), cpu or gpu.")] = "auto",
    time_zero: Annotated[str, _option("each: every A-line at its own; common: all at the earliest.", SHOTS)] = "each",
    energy: Annotated[
        bool, typer.Option("--energy/--no-energy", help="Divide by the pulse energy.", rich_help_panel=SHOTS)
    ] = True,
    sensitivity: Annotated[
        bool,
        typer.Option(
            "--sensitivity/--no-sensitivity",
            help="Correct A-lines for what a wavelength beside the best one left of the film's sensitivity.",
            rich_help_panel=SHOTS,
        ),
    ] = False,
    leave_out: Annotated[
        str, _option("A-lines not used: saturated, mistuned, misfire, partial; or none.", SHOTS)
    ] = "saturated,mistuned",
    bad_lines: Annotated[
        str, _option("A-lines that look bad beside their neighbours: keep, leave-out or mend.", SHOTS)
    ] = "keep",
    zero_first: Annotated[int, _option("Samples to zero (laser pick-up).", CONDITIONING)] = 0,
    remove_offset: Annotated[bool, _option("Subtract each A-line's mean.", CONDITIONING)] = False,
    remove_common: Annotated[
        str | None, _option("Subtract the median or mean of all A-lines (parasitic signal).", CONDITIONING)
    ] = None,
    low_cut: Annotated[float, _option("Lowest that passes, 500kHz.", CONDITIONING, frequency)] = 0.0,
    high_cut: Annotated[float, _option("Highest that passes, 20MHz.", CONDITIONING, frequency)] = 0.0,
    rim: Annotated[float, _option("Fade out over this width at the rim.", CONDITIONING, length)] = 0.0,
    delay: Annotated[float, _option("From laser pulse to first sample.", CONDITIONING, duration)] = 0.0,
    gain: Annotated[float, _option("Time-gain compensation in dB per mm of depth.", DISPLAY)] = 0.0,
    envelope: Annotated[bool, _option("Show the envelope along the depth.", DISPLAY)] = False,
    log_range: Annotated[float | None, _option("Show decibels, down to this many.", DISPLAY)] = None,
    non_negative: Annotated[bool, _option("Show negative values as 0.", DISPLAY)] = False,
    near_field: Annotated[
        float | None,
        _option("Pictures begin at this depth; default: where the sensors' noise ends.", DISPLAY, length),
    ] = None,
    percentile: Annotated[float, _option("Of a projection's values, at which colours end.", DISPLAY)] = 99.9,
    colour_map: Annotated[str, _option("inferno, magma, viridis, cividis, gray or hot.", DISPLAY)] = "inferno",
    scale_bar: Annotated[
        float | None, _option("Length of the bar in pictures, 0 for none; default: round.", DISPLAY, length)
    ] = None,
    size: Annotated[int, _option("Longest side of what pictures show, in pixels.", DISPLAY)] = 720,
    regularisation: Annotated[
        str, _option("thresholding, total-variation, sparsity, tikhonov or none.", ITERATIVE)
    ] = "thresholding",
    strength: Annotated[float | None, _option("Weight of the regulariser; default: by its kind.", ITERATIVE)] = None,
    iterations: Annotated[int, _option("Most iterations.", ITERATIVE)] = 30,
    signed: Annotated[bool, _option("Allow negative values.", ITERATIVE)] = False,
    film: Annotated[str, _option("ideal (no correction), elastic, rule; simulated: as the scan says.", FILM)] = "ideal",
    max_gain: Annotated[float, _option("Largest amplification of a wave, and of the noise.", FILM)] = 10.0,
    thickness: Annotated[float, _option("Of an elastic film.", FILM, length, "38um")] = 38e-6,
    spot: Annotated[
        float | None,
        _option("Diameter of the sensing spot, of a Gaussian beam at 1/e²; default: a point.", FILM, length),
    ] = None,
    spot_profile: Annotated[str, _option("Profile of the sensing spot, gaussian or top-hat.", FILM)] = "gaussian",
    follow: Annotated[
        bool, _option("Make a coarse image every few seconds while it runs, the full one at its end.", FOLLOWING)
    ] = False,
    interval: Annotated[float, _option("Between two of these images.", FOLLOWING, duration, "2s")] = 2.0,
    patience: Annotated[float, _option("Without a new A-line: the scan is over.", FOLLOWING, duration, "60s")] = 60.0,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Make a volume file above 1 GB without asking.")] = False,
) -> None:
    """Reconstruct the initial pressure and write the volume, its projections and a report into a folder."""
    from steradian.reconstructions.parameters import ReconstructionParameters
    from steradian.reconstructions.series.frames import series_choices
    from steradian.scans.file.read import list_frames
    from steradian.scans.frames import FrameChoice
    from steradian.scans.importing.detect import is_scan_file
    from steradian.scans.opening import FIRST, count_frames

    parameters = ReconstructionParameters.create(
        method=method,
        modes=modes,
        upsampling=upsampling,
        **parse_medium(layer, attenuation, sound_speed),
        depth_range=None if first_depth is None and last_depth is None else (first_depth, last_depth),
        weights=weights,
        tolerance=tolerance,
        window=window,
        time_padding=time_padding,
        lateral_padding=lateral_padding,
        highest_frequency=highest_frequency,
        depth_step=depth_step,
        device=device,
        shots={
            "time_zero": time_zero,
            "normalise_energy": energy,
            "correct_sensitivity": sensitivity,
            "bad_lines": bad_lines,
            "leave_out": [flag.strip() for flag in leave_out.split(",") if flag.strip() not in ("", "none")],
        },
        conditioning={
            "zero_first": zero_first,
            "remove_offset": remove_offset,
            "remove_common": remove_common,
            "band": (low_cut, high_cut) if low_cut or high_cut else None,
            "rim": rim,
            "delay": delay,
        },
        display={
            "gain_db_per_mm": gain,
            "envelope": envelope,
            "log_range_db": log_range,
            "non_negative": non_negative,
            "near_field": near_field,
            "percentile": percentile,
            "colour_map": colour_map,
            "scale_bar": scale_bar,
            "size": size,
        },
        iterative={
            "regularisation": regularisation,
            "strength": strength,
            "iterations": iterations,
            "non_negative": not signed,
        },
        film={
            "kind": film,
            "max_gain": max_gain,
            "thickness": thickness,
            "spot": {"diameter": spot, "profile": spot_profile},
        },
    )
    choice = FrameChoice(frame, wavelength, average)
    subsets = parse_subsets(uncertainty, suppress_artefacts, follow=follow)
    if follow and choice != FIRST:
        raise InvalidInput("follow", "true", "without frame, wavelength and average")
    if follow and (align or motion):
        raise InvalidInput("follow", "true", "without align and motion")
    if description is not None or (
        file.is_file() and not is_scan_file(file) and (choice != FIRST or count_frames(file) > 1)
    ):
        from steradian.scans.importing.sandbox import import_in_sandbox

        path, described = parse_description(description)
        output.mkdir(parents=True, exist_ok=True)
        with progress_bar() as progress:
            file = import_in_sandbox(
                file, output / "scan.h5", description=path, options=described, progress=progress
            ).path
    is_series = frame is None and not follow and file.is_file() and is_scan_file(file)
    if is_series and len(series_choices(list_frames(file), wavelength=wavelength, average=average)) > 1:
        refuse_series(subsets)
        selection = {"wavelength": wavelength, "average": average, "align": align, "motion": motion}
        show_series_report(_make_series(file, output, parameters, selection, yes), output)
    elif align:
        raise InvalidInput("align", "true", "a series: a scan file with several frames, none of them chosen")
    elif not follow:
        show_report(
            _make(file, output, parameters, {"frame": choice, "motion": motion, "subsets": subsets}, yes), output
        )
    else:
        from steradian.reconstructions.live.follow import reconstruct_live
        from steradian.reconstructions.warmup import warmup_second_half
        from steradian.scans.file.tail import IdleDetector

        over = IdleDetector(file, patience)
        with warmup_second_half(), progress_bar() as progress:
            report = reconstruct_live(file, output, parameters, is_over=over, interval=interval, progress=progress)
        show_report(report, output)


def _make_series(
    file: Path, output: Path, parameters: ReconstructionParameters, selection: dict[str, Any], agreed: bool
) -> SeriesReport:
    """Reconstruct a series; ask for confirmation on the terminal if its file is large."""
    from steradian.reconstructions.pipeline.size_limit import LargeVolume
    from steradian.reconstructions.series.reconstruct import reconstruct_series

    try:
        with progress_bar() as progress:
            return reconstruct_series(file, output, parameters, **selection, agreed=agreed, progress=progress)
    except LargeVolume as error:
        _confirm(error)
        return _make_series(file, output, parameters, selection, True)


def _make(
    file: Path, output: Path, parameters: ReconstructionParameters, options: dict[str, Any], agreed: bool
) -> Report:
    """Reconstruct a scan; ask for confirmation on the terminal if the volume is large."""
    from steradian.reconstructions.pipeline.run import reconstruct_scan
    from steradian.reconstructions.pipeline.size_limit import LargeVolume
    from steradian.reconstructions.warmup import warmup_second_half

    try:
        with warmup_second_half(), progress_bar() as progress:
            return reconstruct_scan(file, output, parameters, **options, agreed=agreed, progress=progress)
    except LargeVolume as error:
        _confirm(error)
        return _make(file, output, parameters, options, True)


def _confirm(error: LargeVolume) -> None:
    """Ask on the terminal whether a large file is made; raise InvalidInput without a terminal."""
    if not sys.stdin.isatty():
        raise InvalidInput(error.field, error.value, f"{error.allowed} with --yes") from None
    typer.confirm(f"{error}\nMake it?", abort=True, err=True)


def _frequency_or_signal(given: str | float) -> float | str:
    """Parse a frequency with its unit, or the word ``signal`` (limit taken from the A-lines' band)."""
    return given if given == "signal" else frequency(given)
