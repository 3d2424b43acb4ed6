"""Width of an object in a reconstruction, with the point spread at its place and the diameter corrected for it.

The image of a vessel is wider than the vessel by the mask's own point spread, and narrower or wider by the limited
view. Neither adds up in squares, so a model is measured instead: A-lines of a uniform cylinder along the vessel, or of
a uniform sphere, are computed at the scan's own sensors and times, reconstructed with the same parameters and measured
along the same line. The corrected diameter is that at which the model's image is as wide as the measured one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from steradian.errors import InvalidInput
from steradian.imaging import Volume
from steradian.imaging.conditioning import Conditioning
from steradian.phantoms.round import cylinder, sphere
from steradian.progress import IsCancelled, Progress
from steradian.quality.width import Width, find_width
from steradian.reconstructions.film import Film
from steradian.reconstructions.job import reconstruct_recording
from steradian.reconstructions.options import extent_of, sound_speed_of
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.profiles import direction_at, profile
from steradian.reconstructions.scan import Scan
from steradian.reconstructions.shots import ShotTreatment, even_out
from steradian.scans.opening import open_recording
from steradian.scans.recording import Recording

Array = NDArray[np.float64]
Place = Sequence[float]
LEAST_RATIO = 1.1
"""Below so many times the point spread a measured width tells an upper limit of the diameter only."""
_CLOSE = 0.005
_TRIES = 4
_HALF_LENGTH = 6.0
_AROUND = 8.0
_FROM_A_LINE = "the recording is of a line of sensors, of which the point spread is not simulated"


def measure_width(
    volume: Volume,
    scan: Scan | Recording | str | Path,
    start: Place,
    end: Place,
    *,
    parameters: ReconstructionParameters | None = None,
    frame: int | None = 0,
    progress: Progress | None = None,
    cancelled: IsCancelled | None = None,
) -> Width:
    """Measure an object's full width at half maximum along a line, and correct it for the scan's own point spread.

    Parameters
    ----------
    volume
        The image [x, y, z].
    scan
        The scan it was reconstructed from: for sensors, times, weights.
    start, end
        x, y, z in metres of the ends of a line across the object.
    parameters
        Those of the reconstruction; ``None``: the defaults.
    frame
        Which frame of the scan; None: the only one.
    progress, cancelled
        See :mod:`steradian.progress`.

    Returns
    -------
    Width
        Lengths in metres; ``centre``, ``left`` and ``right`` are distances from ``start``.

    Raises
    ------
    InvalidInput
        When the line leaves the volume, or the profile does not fall to a half on both sides of its peak.
    Cancelled
        When ``cancelled`` said so.
    """
    line = _checked_line(volume, start, end)
    measured = find_width(*profile(volume, *line))
    if measured is None:
        raise InvalidInput("end", tuple(end), "the end of a line across one object, with what lies beside it")
    recording = _recording(scan, frame)
    if volume.dimensions == 2:
        return replace(measured, reason=_FROM_A_LINE)
    model = _Model.of(volume, recording, parameters or ReconstructionParameters(), line, measured)
    return model.correct(measured, progress, cancelled)


def _checked_line(volume: Volume, start: Place, end: Place) -> tuple[Array, Array]:
    ends = []
    for name, given in (("start", start), ("end", end)):
        place = np.asarray(given, dtype=np.float64)
        if place.shape != (len(volume.names),) or not np.isfinite(place).all():
            raise InvalidInput(name, tuple(given), f"{', '.join(volume.names)} in metres")
        for axis, value in zip(volume.names, place, strict=True):
            at = volume.coordinates(axis)
            if not at[0] - 1e-9 <= value <= at[-1] + 1e-9:
                raise InvalidInput(f"{name}.{axis}", value, f"{at[0]:.6g} to {at[-1]:.6g} m")
        ends.append(place)
    if np.allclose(ends[0], ends[1], rtol=0, atol=1e-9):
        raise InvalidInput("end", tuple(end), "another place than start")
    return ends[0], ends[1]


def _recording(scan: Scan | Recording | str | Path, frame: int | None) -> Recording:
    if isinstance(scan, Recording):
        return scan
    return scan.recording(frame) if isinstance(scan, Scan) else open_recording(Path(scan), frame or 0)


@dataclass(frozen=True)
class _Model:
    """An object of any diameter at the measured place, sensed and reconstructed as the scan was."""

    recording: Recording
    parameters: ReconstructionParameters
    line: tuple[Array, Array]
    place: Array
    direction: Array | None
    half_length: float
    amplitude: float
    step: float

    @classmethod
    def of(
        cls,
        volume: Volume,
        recording: Recording,
        parameters: ReconstructionParameters,
        line: tuple[Array, Array],
        measured: Width,
    ) -> _Model:
        recording, _ = even_out(recording, parameters.shots)
        along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
        place = line[0] + measured.centre * along
        around = _AROUND * measured.fwhm
        speed = sound_speed_of(recording, parameters)
        step = speed * recording.sampling_interval
        deepest = (extent_of(recording, parameters).end - 1) * step
        ends = (float(line[0][2]), float(line[1][2]))
        depths = (max(0.0, min(ends) - around), min(deepest, max(ends) + around))
        local = parameters.model_copy(
            update={
                "depth_range": depths,
                "sound_speed": speed,
                "film": Film(),
                "shots": ShotTreatment(),
                "conditioning": Conditioning(band=parameters.conditioning.band, delay=parameters.conditioning.delay),
            }
        )
        direction = direction_at(volume, place, measured.fwhm)
        half_length = _HALF_LENGTH * measured.fwhm
        return cls(recording, local, line, place, direction, half_length, measured.height, step)

    @property
    def shape(self) -> str:
        """Name of the object's shape."""
        return "sphere" if self.direction is None else "cylinder"

    def width(self, diameter: float, progress: Progress | None, cancelled: IsCancelled | None) -> float:
        """Return the width of the image of an object of a diameter in metres; not a number where it has none."""
        from steradian.phantoms.forward import pressure

        balls = (
            sphere(diameter, self.place, self.step)
            if self.direction is None
            else cylinder(diameter, self.place, self.direction, self.half_length, self.step)
        )
        recording = self.recording
        traces = pressure(
            balls,
            recording.positions,
            samples=recording.traces.shape[1],
            sampling_interval=recording.sampling_interval,
            sound_speed=float(self.parameters.sound_speed or 0),
            time_zero=recording.time_zero + self.parameters.conditioning.delay,
            progress=progress,
            cancelled=cancelled,
        )
        made = replace(recording, traces=traces, scale=1.0, shots=None)
        volume = reconstruct_recording(made, self.parameters, progress=progress, cancelled=cancelled)
        found = find_width(*profile(volume, *self.line))
        return float("nan") if found is None else found.fwhm

    def correct(self, measured: Width, progress: Progress | None, cancelled: IsCancelled | None) -> Width:
        """Find the diameter whose image is as wide as the measured one."""
        spread = self.width(0.0, progress, cancelled)
        about = replace(measured, point_spread=spread, shape=self.shape)
        if not np.isfinite(spread):
            return replace(about, point_spread=None, reason="the point spread at this place has no width of its own")
        resolved = measured.fwhm >= LEAST_RATIO * spread
        wanted = measured.fwhm if resolved else LEAST_RATIO * spread
        found = self._diameter(wanted, spread, progress, cancelled)
        if found is None:
            return replace(about, reason="no diameter's image is as wide as this at this place")
        if resolved:
            return replace(about, corrected=found, reason="")
        why = f"the image is not wider than {LEAST_RATIO:g} times the point spread: the diameter is at most at_most"
        return replace(about, at_most=found, reason=why)

    def _diameter(
        self, wanted: float, spread: float, progress: Progress | None, cancelled: IsCancelled | None
    ) -> float | None:
        """Solve for the diameter; the squares of widths grow nearly evenly with the diameter's."""
        diameter = float(np.sqrt(wanted**2 - spread**2))
        for _ in range(_TRIES):
            got = self.width(diameter, progress, cancelled)
            if not (np.isfinite(got) and got > spread):
                return None
            if abs(got - wanted) < _CLOSE * wanted:
                return diameter
            diameter *= float(np.sqrt((wanted**2 - spread**2) / (got**2 - spread**2)))
        return diameter
