"""Retrospective undersampling: reconstruct a scan as if only a sparse mask had been measured.

The A-lines that a mask would have measured are picked from those of a finished dense scan, reconstructed with the
mask's weights, and compared with the image of all A-lines.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import Volume
from steradian.masks import Mask
from steradian.quality import above_threshold, compare, correlation, disc
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.resolve import effective_parameters, film_of
from steradian.reconstructions.pipeline.run import reconstruct_in_memory, write_json
from steradian.reconstructions.shot_normalisation import normalise_shots
from steradian.reconstructions.volumes.near_field import crop_depth, near_field_depth
from steradian.scans.frames import FrameChoice
from steradian.scans.opening import FIRST, open_recording
from steradian.scans.recording import Recording

Points = Literal["nearest", "exact"]
SAME_PLACE = 1e-6
"""Distance, in apertures, at which a point of the mask counts as measured exactly (14 nm of 13.56 mm)."""
DISC_DIAMETERS = 6
"""Discs around the point of interest for which the correlation is given, up to the aperture's size."""


@dataclass(frozen=True)
class TimedImage:
    """Reconstructed image and the seconds that its reconstruction took."""

    volume: Volume
    seconds: float


@dataclass
class SubsetReport:
    """Comparison of an undersampled image with the full one, as written to ``what-if.json``."""

    mask_id: str
    scan_points: int
    """A-lines of the scan."""
    asked: int
    """Points of the mask."""
    used: int
    """Different A-lines they picked."""
    merged: int = 0
    """Points that picked an A-line another point had picked; their weights are added up."""
    points: Points = "nearest"
    displacement_m: dict[str, float] = field(default_factory=dict)
    """From a point of the mask to the point measured: ``largest`` and ``rms``."""
    weights: str = ""
    share: float = 0.0
    """A-lines used over those of the scan."""
    saved: dict[str, float] = field(default_factory=dict)
    """``points``; ``scan_share``, of the pulses; ``reconstruction_seconds``."""
    diameter_m: float | None = None
    """Of the disc around the point of interest that ``quality`` is about; none: everywhere."""
    threshold: float = 0.04
    quality: dict[str, float | None] = field(default_factory=dict)
    """:func:`steradian.quality.compare` with the image of all A-lines, without the sharpness, which artefacts of few
    sensors raise; none where a figure is undefined."""
    correlation_by_diameter: dict[str, float] = field(default_factory=dict)
    """Of the z-projections over the pixels of interest, by the disc's diameter in metres."""
    shape: tuple[int, ...] = ()
    spacing_m: tuple[float, ...] = ()
    parameters: dict[str, Any] = field(default_factory=dict)
    provenance: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    """What was decided or assumed about the recording."""
    seconds: dict[str, float] = field(default_factory=dict)


def compare_subset(
    scan: Path,
    mask: Mask,
    output: Path,
    parameters: ReconstructionParameters | None = None,
    *,
    points: Points = "nearest",
    diameter: float | None = None,
    threshold: float = 0.04,
    frame: int | FrameChoice = FIRST,
    full: TimedImage | None = None,
    image: TimedImage | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> SubsetReport:
    """Reconstruct a scan from the A-lines in a sparse mask, and compare with the image of all A-lines.

    Writes ``mip-z.png`` (through the mask), ``mip-z-full.png`` (of all A-lines) and ``what-if.json``; for a line of
    sensors ``mip-y.png`` and ``mip-y-full.png``, the images themselves.

    Parameters
    ----------
    scan
        A scan file or another known recording.
    mask
        What to pretend was scanned; within the recording's aperture. Both images have the recording's aperture and
        voxels.
    output
        Folder for the results.
    parameters
        Of both images. Weights "mask": of the image through the mask the mask's own; the others are found anew for the
        points picked.
    points
        ``nearest``: each point of the mask picks the A-line measured nearest to it, and points that pick the same one
        are merged; ``exact``: only a mask whose points were all measured.
    diameter
        Of the disc (in 2-D: strip) around the mask's point of interest in which images are compared, in metres. None:
        twice the depth of the point of interest, i.e. within 45° of it; without such a point everywhere.
    threshold
        Share of the maximum of the full image from which pixels are of interest (paper, section 6).
    frame
        Which frame, or which frames' mean, of a scan that has several; by default the first, with a note.
    full, image
        The images of all A-lines and through the mask, by the same parameters, where they are there already.
    progress, cancelled
        Reported and asked between pieces of work.

    Raises
    ------
    NotFound, DamagedFile
        When the recording cannot be read.
    InvalidInput
        When the mask does not fit the recording, an exact mask has points that were not measured, or a parameter does
        not fit.
    Cancelled
        When ``cancelled`` said so.
    """
    chosen = parameters or ReconstructionParameters()
    seconds: dict[str, float] = {}
    with _timed(seconds, "read"):
        recording, _ = normalise_shots(
            open_recording(scan, frame), chosen.shots, progress=progress, cancelled=cancelled
        )
        sparse, report = select_subset(recording, mask, points)
    full = full or timed_reconstruction(recording, chosen, progress=progress, cancelled=cancelled)
    image = image or timed_reconstruction(sparse, chosen, progress=progress, cancelled=cancelled)
    seconds |= {"reconstruct_all": full.seconds, "reconstruct_mask": image.seconds}
    if diameter is None and mask.depth is not None:
        diameter = min(2 * mask.depth, recording.aperture)
    with _timed(seconds, "compare"):
        figures = compare(image.volume, full.volume, diameter=diameter, threshold=threshold, centre=mask.offset)
        report.quality = {
            name: value if np.isfinite(value) else None for name, value in figures.items() if "sharpness" not in name
        }
        if image.volume.dimensions == 3:
            report.correlation_by_diameter = _by_diameter(image.volume, full.volume, mask.offset, threshold)
    report.diameter_m, report.threshold = diameter, threshold
    report.weights = chosen.weights
    report.shape, report.spacing_m = image.volume.values.shape, tuple(map(float, image.volume.spacing))
    report.parameters, report.provenance = effective_parameters(recording, chosen), recording.provenance
    info = image.volume.info
    report.notes = [*(info.notes if info else ()), *recording.notes, *chosen.film.notes(film_of(recording))]
    report.saved["reconstruction_seconds"] = seconds["reconstruct_all"] - seconds["reconstruct_mask"]
    output.mkdir(parents=True, exist_ok=True)
    with _timed(seconds, "draw"):
        _draw(image.volume, full.volume, output, chosen, sparse.positions)
    report.seconds = {name: round(value, 3) for name, value in seconds.items()}
    write_json(output / "what-if.json", report)
    return report


def timed_reconstruction(
    recording: Recording,
    parameters: ReconstructionParameters,
    *,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> TimedImage:
    """Reconstruct a recording and measure the time in seconds."""
    began = time.perf_counter()
    volume = reconstruct_in_memory(recording, parameters, progress=progress, cancelled=cancelled)
    return TimedImage(volume, time.perf_counter() - began)


def select_subset(recording: Recording, mask: Mask, points: Points = "nearest") -> tuple[Recording, SubsetReport]:
    """Select the A-lines at the points of a sparse mask (retrospective undersampling), with a report.

    Returns
    -------
    tuple
        The recording through the mask, each A-line once, with the mask's weights (of merged points their sum, so that
        the total stays), and a report of what was picked.

    Raises
    ------
    InvalidInput
        As :func:`compare_subset`.
    """
    from scipy.spatial import KDTree

    if points not in ("nearest", "exact"):
        raise InvalidInput("points", points, "nearest or exact")
    axes = recording.positions.shape[1]
    if mask.positions.shape[1] != axes:
        kinds = {1: "a line", 2: "a plane"}
        raise InvalidInput("mask", kinds[mask.positions.shape[1]], f"{kinds[axes]} of points, like the scan")
    reach = float(np.abs(mask.positions).max())
    if reach > recording.aperture / 2 * (1 + 1e-9):
        half = 1e3 * recording.aperture / 2
        raise InvalidInput("mask", f"a point at {1e3 * reach:.4g} mm", f"within the scan's aperture, ±{half:.4g} mm")
    apart, nearest = (np.asarray(v) for v in KDTree(recording.positions).query(mask.positions))
    if points == "exact":
        _require_measured(apart, recording.aperture)
    used, which = np.unique(nearest, return_inverse=True)
    weights = np.asarray(np.bincount(which, weights=mask.weights), np.float64)
    count = len(recording.positions)
    scale = recording.scale if np.ndim(recording.scale) == 0 else np.asarray(recording.scale)[used]
    sparse = replace(
        recording,
        traces=recording.traces[used],
        scale=scale,
        positions=recording.positions[used],
        shots=None if recording.shots is None else recording.shots.select(used),
        rows=None if recording.rows is None else recording.rows[used],
        weights=weights,
        outline=mask.outline,
        depth=mask.depth,
        planned=mask.count,
    )
    return sparse, SubsetReport(
        mask_id=mask.id,
        scan_points=count,
        asked=mask.count,
        used=len(used),
        merged=mask.count - len(used),
        points=points,
        displacement_m={"largest": float(apart.max()), "rms": float(np.sqrt(np.mean(apart**2)))},
        share=len(used) / count,
        saved={"points": count - len(used), "scan_share": 1 - len(used) / count},
    )


def _require_measured(apart: NDArray[np.float64], aperture: float) -> None:
    missing = int((apart > SAME_PLACE * aperture).sum())
    if missing:
        raise InvalidInput(
            "mask",
            f"{missing} of {len(apart)} points not measured, the farthest {1e6 * apart.max():.4g} µm from one that is",
            "points of the scan; or points='nearest'",
        )


def _by_diameter(image: Volume, full: Volume, centre: tuple[float, float], threshold: float) -> dict[str, float]:
    """Return the correlation of the z-projections in discs of growing diameter; discs without signal are omitted."""
    shown, model = image.mip("z"), full.mip("z")
    interest = above_threshold(model, threshold)
    x, y = full.coordinates("x"), full.coordinates("y")
    size = full.spacing[0] * model.shape[0]
    found = {}
    for diameter in size * np.arange(1, DISC_DIAMETERS + 1) / DISC_DIAMETERS:
        region = interest & disc(x, y, float(diameter), centre)
        if region.sum() > 2:
            found[f"{diameter:.6g}"] = correlation(shown, model, region)
    return found


def _draw(
    image: Volume, full: Volume, output: Path, parameters: ReconstructionParameters, positions: NDArray[np.float64]
) -> None:
    from steradian.reconstructions.volumes.images import Axis, draw_mip

    axis: Axis = "z" if image.dimensions == 3 else "y"
    near = parameters.display.near_field
    near = near_field_depth(image, positions) if near is None else near
    for volume, name in ((image, f"mip-{axis}.png"), (full, f"mip-{axis}-full.png")):
        # both from the same depth, so that they can be compared
        draw_mip(parameters.display.apply(crop_depth(volume, near)), axis, output / name, parameters.display)


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    began = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - began
