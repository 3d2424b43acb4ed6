"""The job: from a file of A-lines to a volume, its projections and a report."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from steradian.errors import InvalidInput
from steradian.imaging import Volume, reconstruct
from steradian.imaging.conditioning import Conditioning
from steradian.progress import IsCancelled, Progress
from steradian.reconstructions.parameters import DEFAULT_SPACING, ReconstructionParameters
from steradian.reconstructions.volume_file import write_volume
from steradian.scans.recording import Recording, open_recording


@dataclass
class Report:
    """Figures of a finished reconstruction, as written to ``report.json``."""

    shape: tuple[int, ...] = ()
    spacing_m: tuple[float, ...] = ()
    axes: str = "x, y, z"
    sensors: int = 0
    planned: int = 0
    sound_speed_m_s: float = 0.0
    parameters: dict[str, object] = field(default_factory=dict)
    provenance: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    """Wall time of each stage."""

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Note the wall time of a stage."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = round(time.perf_counter() - start, 3)


def reconstruct_scan(
    scan: Path,
    output: Path,
    parameters: ReconstructionParameters | None = None,
    *,
    progress: Progress | None = None,
    cancelled: IsCancelled | None = None,
) -> Report:
    """Reconstruct a recording and write ``volume.h5``, ``mip-{x,y,z}.png`` and ``report.json`` into a folder.

    Parameters
    ----------
    scan
        A scan file or another known recording (:func:`steradian.scans.recording.open_recording`).
    output
        Folder for the results; each appears under its name only when it is whole.
    parameters
        What to choose; the defaults fit a scan.
    progress, cancelled
        Reported and asked between pieces of work.

    Raises
    ------
    NotFound, DamagedFile
        When the recording cannot be read.
    InvalidInput
        When a parameter does not fit the recording.
    Cancelled
        When ``cancelled`` said so.
    """
    chosen = parameters or ReconstructionParameters()
    report = Report(parameters=chosen.model_dump(mode="json"))
    with report.timed("read"):
        recording = open_recording(scan)
    with report.timed("reconstruct"):
        volume = reconstruct_recording(recording, chosen, progress=progress, cancelled=cancelled)
    report.axes = ", ".join(volume.names)
    report.shape, report.spacing_m = volume.values.shape, tuple(map(float, volume.spacing))
    report.sensors, report.planned = len(recording.positions), recording.planned
    report.sound_speed_m_s = _sound_speed(recording, chosen)
    report.provenance = recording.provenance
    output.mkdir(parents=True, exist_ok=True)
    with report.timed("write"):
        write_volume(output / "volume.h5", volume, parameters=report.parameters, provenance=recording.provenance)
    with report.timed("draw"):
        from steradian.reconstructions.pictures import PLANES, Axis, draw_mip

        shown = chosen.display.apply(volume)
        axes: tuple[Axis, ...] = tuple(PLANES) if volume.dimensions == 3 else ("y",)
        for axis in axes:
            draw_mip(shown, axis, output / f"mip-{axis}.png", chosen.display)
    _write_report(output / "report.json", report)
    return report


def reconstruct_recording(
    recording: Recording,
    parameters: ReconstructionParameters,
    *,
    progress: Progress | None = None,
    cancelled: IsCancelled | None = None,
) -> Volume:
    """Reconstruct a recording in memory; see :func:`reconstruct_scan`."""
    traces = np.multiply(recording.traces, np.asarray(recording.scale, np.float32).reshape(-1, 1), dtype=np.float32)
    if parameters.conditioning != Conditioning():
        traces = parameters.conditioning.apply(
            traces, recording.positions, sampling_interval=recording.sampling_interval, aperture=recording.aperture
        )
    return reconstruct(
        traces,
        recording.positions,
        sampling_interval=recording.sampling_interval,
        sound_speed=_sound_speed(recording, parameters),
        aperture=recording.aperture,
        modes=_modes(recording, parameters),
        weights=_weights(recording, parameters),
        upsampling=parameters.upsampling,
        depth_range=_depth_range(recording, parameters),
        method=parameters.method,
        tolerance=parameters.tolerance,
        window=parameters.window,
        time_zero=recording.time_zero + parameters.conditioning.delay,
        time_padding=parameters.time_padding,
        lateral_padding=parameters.lateral_padding,
        progress=progress,
        cancelled=cancelled,
    )


def _sound_speed(recording: Recording, parameters: ReconstructionParameters) -> float:
    speed = parameters.sound_speed or recording.sound_speed
    if speed is None:
        raise InvalidInput("sound_speed", "missing", "300 to 6000 (m/s); the recording states none")
    return speed


def _modes(recording: Recording, parameters: ReconstructionParameters) -> int:
    return parameters.modes or recording.grid or max(2, round(recording.aperture / DEFAULT_SPACING))


def _depth_range(recording: Recording, parameters: ReconstructionParameters) -> tuple[float, float] | None:
    if parameters.depth_range is None:
        return None
    first, last = parameters.depth_range
    end = (recording.traces.shape[1] - 1) * recording.sampling_interval * _sound_speed(recording, parameters)
    return first or 0.0, end if last is None else last


def _weights(recording: Recording, parameters: ReconstructionParameters) -> np.ndarray | str | None:
    match parameters.weights:
        case "mask":
            return recording.weights
        case "uniform":
            return None
        case "voronoi":
            return "voronoi"


def _write_report(path: Path, report: Report) -> None:
    draft = path.with_name(path.name + ".new")
    draft.write_text(json.dumps(asdict(report), indent=2) + "\n")
    draft.replace(path)
