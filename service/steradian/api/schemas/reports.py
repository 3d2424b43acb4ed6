"""Response schemas of stored reports (scan summary, plan preview, job results).

Another version may have written them: unknown fields are passed on unchanged; missing or invalid fields are null.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal, TypeAlias

from pydantic import BaseModel, Field

from steradian.api.schemas.report_base import ReportBase
from steradian.api.schemas.series import FrameView, OxygenationView, RegionsView, UnmixingView


class HistoryView(ReportBase):
    """Change of state of a scan or job: new state, time, author and reason."""

    state: str = Field(description="What it became", examples=["running"])
    at: datetime
    who: str | None = Field(default=None, description="The key's name, or the process", examples=["local"])
    why: str | None = None


class AttemptView(ReportBase):
    """Attempt: one execution of a job, with its worker and outcome."""

    number: int = Field(description="Counts starts, but not those that were put back", examples=[1])
    worker: str | None = Field(default=None, examples=["worker-0"])
    started: datetime | None = None
    ended: datetime | None = None
    outcome: str | None = Field(default=None, description="succeeded, failed, died, interrupted, put back or cancelled")
    detail: str | None = Field(default=None, examples=["killed by signal SIGKILL"])


class SummaryView(ReportBase):
    """Summary of a finished scan: counts of A-lines and shots."""

    points: int | None = Field(default=None, description="A-lines that were planned, of all frames")
    stored: int | None = Field(default=None, description="Stored A-lines")
    fired: int | None = Field(default=None, description="Shots that the scanner fired")


class RemarkView(BaseModel):
    """Finding about a plan: an error rejects the scan, a warning does not."""

    severity: Literal["error", "warning"]
    field: str = Field(description="The field of the plan to change", examples=["pulse_rate"])
    message: str
    allowed: str = Field(
        description="The range of the field that would do", examples=["at most 92.1 Hz over this link"]
    )


class PreviewView(ReportBase):
    """Cost of a plan: shots, time and data."""

    seconds: dict[str, float] | None = Field(
        default=None,
        description="Time (s) each part needs by itself: laser, mover, tuning, gate, link, disk",
        examples=[{"laser": 32.0}],
    )
    laser_seconds: float | None = Field(default=None, description="s")
    total_seconds: float | None = Field(default=None, description="Time of the scan (s); the parts overlap")
    least_seconds: float | None = Field(
        default=None, description="Time (s) where the stopping rule ends the scan as early as it may"
    )
    limiting: Literal["laser", "mover", "tuning", "gate", "link", "disk"] | None = Field(
        default=None, description="The part that decides the time"
    )
    travel: float | None = Field(default=None, description="Way of the beam (m)")
    retunings: int | None = Field(default=None, description="How often the bias wavelength changes")
    bands: int = Field(default=0, description="How many bias wavelengths are set; 0: the scanner's own")
    sensitivity_loss: dict[str, float] = Field(
        default_factory=dict,
        description="Share of sensitivity lost to wavelengths beside the best: max, mean, and expected, the mean with"
        " the uncertainty of the best ones",
        examples=[{"max": 0.1, "mean": 0.03, "expected": 0.04}],
    )
    beams: int = Field(default=1, description="How many interrogation beams record each shot")
    displacement: dict[str, float] = Field(
        default_factory=dict,
        description="How far the points of the mask asked for are from the nearest one measured (m): median, largest",
        examples=[{"median": 1e-4, "largest": 7e-4}],
    )
    bytes: int | None = Field(default=None, description="Size of the A-lines' samples")
    oxygenation: OxygenationView | None = Field(default=None, description="Of several excitation wavelengths")
    findings: list[RemarkView] | None = None


class FitView(ReportBase):
    """Convergence of an iterative reconstruction."""

    iterations: int | None = None
    stopped: str | None = Field(
        default=None,
        description="Stopping criterion: discrepancy, change, misfit (no further improvement) or iterations",
    )
    products: int | None = Field(default=None, description="Products with the model, or direct reconstructions, in all")
    misfit: float | None = Field(default=None, description="Of the image, relative to the A-lines")
    misfits: list[float] | None = Field(default=None, description="After each iteration")


class BadLinesView(ReportBase):
    """Numbers of bad A-lines that were left out or mended in a reconstruction."""

    treatment: Literal["leave-out", "mend"] | None = None
    looked_at: int | None = Field(default=None, description="A-lines that were compared with their neighbours")
    decidable: bool | None = Field(default=None, description="Whether inverted and shifted A-lines could be detected")
    left_out: dict[str, int] = Field(default_factory=dict, description="A-lines not used, by kind")
    mended: dict[str, int] = Field(default_factory=dict, description="A-lines mended, by kind")
    rows: dict[str, list[int]] = Field(
        default_factory=dict, description="By kind their numbers in the array of A-lines; 500 of a kind at most"
    )
    shifts_s: list[float] | None = Field(default=None, description="Least and greatest shift moved back (s)")


class UnevennessView(ReportBase):
    """Variation of energy, time zero and sensitivity between A-lines, and the excluded A-lines."""

    left_out: dict[str, int] = Field(default_factory=dict, description="A-lines not used, by flag")
    energy: list[float] | None = Field(default=None, description="Least and greatest pulse energy, relative to nominal")
    time_zero_s: list[float] | None = Field(default=None, description="Earliest and latest time zero (s)")
    sensitivity: list[float] | None = Field(
        default=None, description="Least and greatest share of the film's sensitivity divided by; null: by none"
    )
    bad_lines: BadLinesView | None = Field(default=None, description="null: not searched for")


class ReportView(ReportBase):
    """Report of a reconstruction: figures and provenance."""

    shape: list[int] | None = Field(default=None, description="Voxels along each axis", examples=[[226, 226, 512]])
    spacing_m: list[float] | None = Field(default=None, description="Distance of voxels along each axis (m)")
    origin_m: list[float] | None = Field(default=None, description="Centre of the first voxel along each axis (m)")
    centre_m: list[float] | None = Field(
        default=None,
        description="Place of x = y = 0 in the frame of the imported file (m); empty where it is ours",
    )
    axes: str | None = Field(default=None, examples=["x, y, z"])
    sensors: int | None = Field(default=None, description="A-lines the image is made of")
    planned: int | None = Field(default=None, description="A-lines that the scan was to have")
    sound_speed_m_s: float | None = Field(default=None, description="m/s; of several layers that of the slowest")
    sensed_area_m2: float | None = Field(default=None, description="Sum of the weights (m², m for a line)")
    notes: list[str] | None = Field(default=None, description="Notes on the image's reliability")
    parameters: dict[str, Any] | None = Field(default=None, description="As they took effect")
    provenance: dict[str, Any] | None = Field(default=None, description="Provenance")
    missing: dict[str, Any] | None = Field(default=None, description="Missing parts of a partly measured scan")
    fit: FitView | None = None
    noise_gain: list[list[float]] | None = Field(
        default=None,
        description="Pairs of a depth (m) and the amplification of noise by the compensation of attenuation",
    )
    shots: UnevennessView | None = None
    device: str | None = Field(default=None, description="Device: cpu, or the GPU's name", examples=["cpu"])
    near_field_m: float | None = Field(default=None, description="Depth from which on the pictures show it (m)")
    scale_percentile: float | None = None
    scale_ends: dict[str, float] | None = Field(default=None, description="Value at the end of each picture's scale")
    seconds: dict[str, float] | None = Field(default=None, description="Wall time of each stage (s)")
    what_if: dict[str, Any] | None = Field(default=None, description="Correlation with the image of all points")
    frames: list[FrameView] | None = Field(
        default=None, description="Volumes of a series, in the order of index; null: it is one volume"
    )
    unmixing: UnmixingView | None = Field(default=None, description="Of the maps of an unmixing")
    files: list[str] | None = Field(default=None, description="Names of the files it left")


class ObjectWidth(ReportBase):
    """Full width at half maximum along a line, with the object's corrected diameter."""

    fwhm: float | None = Field(default=None, description="As the image shows it (m)")
    repeatability: float | None = Field(default=None, description="Of fwhm under the noise (m)")
    point_spread: float | None = Field(default=None, description="Width of the image of a thin object there (m)")
    corrected: float | None = Field(default=None, description="Diameter whose image is as wide as fwhm (m)")
    at_most: float | None = Field(default=None, description="Largest diameter, where it is as wide as a thin one (m)")
    shape: str | None = Field(default=None, description="What was simulated", examples=["uniform cylinder"])
    reason: str | None = Field(default=None, description="Reason why there is no corrected diameter")
    base: float | None = Field(default=None, description="Level beside the object")
    height: float | None = Field(default=None, description="Of the peak above it")
    centre: float | None = Field(default=None, description="Distance of the object from start (m)")
    left: float | None = Field(default=None, description="Where the profile rises to a half (m from start)")
    right: float | None = Field(default=None, description="Where it falls to a half (m from start)")


class FoundParameterView(ReportBase):
    """Parameter of a medium that a search found."""

    name: str | None = Field(default=None, examples=["layer1.sound_speed", "layer1.thickness", "time_zero"])
    unit: str | None = Field(default=None, description="Of all values", examples=["m/s", "m", "s"])
    start: float | None = Field(default=None, description="Where the search began")
    value: float | None = Field(default=None, description="What was found")
    standard_error: float | None = Field(default=None, description="Of value (68 %)")
    low: float | None = Field(default=None, description="Begin of the range searched")
    high: float | None = Field(default=None, description="End of the range searched")
    at_edge: bool | None = Field(default=None, description="Whether the value is at an end of the range")
    criterion: str | None = Field(default=None, examples=["misfit", "sharpness", "boundary echo"])
    values: list[float] | None = Field(default=None, description="Values tried, the other parameters held")
    criterion_values: list[float] | None = Field(default=None, description="Criterion there")


class SoundSpeedView(ReportBase):
    """Result of a sound-speed search: best speed and sharpness by speed, or the parameters found of a medium."""

    sound_speeds: list[float] | None = Field(default=None, description="Speeds tried, rising (m/s)")
    sharpness: list[float] | None = Field(default=None, description="At each of them, normalised")
    best: float | None = Field(default=None, description="Speed found (m/s)")
    standard_error: float | None = Field(default=None, description="Of best (m/s), where it was asked for")
    at_edge: bool | None = Field(
        default=None, description="Whether the best is the first or last: the range should be moved"
    )
    parameters: list[FoundParameterView] | None = Field(
        default=None, description="Parameters of the medium, in the order asked for; null: of one speed"
    )
    medium: dict[str, Any] | None = Field(default=None, description="Layers with the values found; null: of one speed")
    time_zero: float | None = Field(default=None, description="Time of the first sample, with the value found (s)")
    correlations: list[list[float]] | None = Field(default=None, description="Of the parameters' errors")
    notes: list[str] | None = Field(default=None, description="Decisions and assumptions about the scan")


class ComparisonView(ReportBase):
    """Result of a comparison: similarity of two volumes."""

    figures: dict[str, float | None] | None = Field(
        default=None, description="Correlations, sharpness and error", examples=[{"volume_correlation": 0.48}]
    )


class WidthView(ReportBase):
    """Result of a width measurement of an object in an image."""

    width: ObjectWidth | None = Field(default=None, description="Width, point spread and corrected diameter")


class ExportView(ReportBase):
    """Result of an export or a figure."""

    bytes: int | None = Field(default=None, description="Size of the file")


class ImportView(ReportBase):
    """Result of an import."""

    scan_id: str | None = None
    plan_id: str | None = None
    mask_id: str | None = None
    points: int | None = Field(default=None, description="A-lines that were planned, of all frames")
    stored: int | None = Field(default=None, description="Stored A-lines")
    fired: int | None = Field(default=None, description="Shots that the scanner fired")


class ImageView(ReportBase):
    """Voxel grid of a live reconstruction's revision."""

    shape: list[int] | None = Field(default=None, examples=[[226, 226, 256]])
    spacing_m: list[float] | None = Field(default=None, description="Distance of voxels along each axis (m)")
    decimation: int | None = Field(default=None, description="Ratio of its depth step to that of the full image")
    modes: int | None = None


Result: TypeAlias = SoundSpeedView | ComparisonView | ExportView | ImportView | ReportView | WidthView | RegionsView
"""What a job found."""
_RESULTS: dict[str, type[Result]] = {
    "sound-speed": SoundSpeedView,
    "quality": ComparisonView,
    "width": WidthView,
    "regions": RegionsView,
    "export": ExportView,
    "figure": ExportView,
    "import": ImportView,
}


def result_of(kind: str, found: dict[str, Any]) -> Result | None:
    """Return the result of a job as the schema of its kind; ``None`` before it has one."""
    return _RESULTS.get(kind, ReportView).model_validate(found) if found else None
