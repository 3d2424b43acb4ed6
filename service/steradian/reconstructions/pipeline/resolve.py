"""Resolve request parameters against a recording."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.units import SOUND_SPEED
from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.geometry.sensor_areas import sensed_region
from steradian.imaging.geometry.voronoi import voronoi_cell_areas
from steradian.imaging.parameters import Parameters
from steradian.imaging.signal.conditioning import Conditioning
from steradian.reconstructions.parameters import ReconstructionParameters, default_modes
from steradian.scans.recording import Recording


def effective_parameters(recording: Recording, parameters: ReconstructionParameters) -> dict[str, Any]:
    """Return the parameters as they take effect: also those of which the recording decides."""
    decided = {"sound_speed": sound_speed_of(recording, parameters), "modes": modes_of(recording, parameters)}
    return parameters.model_dump(mode="json") | decided


def preprocess(recording: Recording, parameters: ReconstructionParameters) -> NDArray[np.float32]:
    """Return A-lines (M, N_t) in units of pressure, treated as the parameters say."""
    scale = np.asarray(recording.scale, np.float32).reshape(-1, 1)
    traces: NDArray[np.float32] = np.multiply(recording.traces, scale, dtype=np.float32)
    if parameters.conditioning == Conditioning():
        return traces
    return parameters.conditioning.apply(
        traces, recording.positions, sampling_interval=recording.sampling_interval, aperture=recording.aperture
    )


def to_imaging_parameters(recording: Recording, parameters: ReconstructionParameters) -> Parameters:
    """Return the arguments of a reconstruction other than positions and traces.

    Raises
    ------
    InvalidInput
        When a parameter does not fit the recording.
    """
    return Parameters(
        sampling_interval=recording.sampling_interval,
        sound_speed=sound_speed_of(recording, parameters),
        aperture=recording.aperture,
        modes=modes_of(recording, parameters),
        weights=weights_of(recording, parameters),
        upsampling=parameters.upsampling,
        depth_range=depth_range_of(recording, parameters),
        method=parameters.method,
        tolerance=parameters.tolerance,
        window=parameters.window,
        time_zero=begins_at(recording, parameters),
        time_padding=parameters.time_padding,
        lateral_padding=parameters.lateral_padding,
        highest_frequency=parameters.highest_frequency,
        depth_step=parameters.depth_step,
        correction=parameters.film.correction(film_of(recording)),
        iterative=parameters.iterative if parameters.method == "iterative" else None,
        device=parameters.device,
    )


def sound_speed_of(recording: Recording, parameters: ReconstructionParameters) -> float:
    """Return the effective speed of sound in m/s; raises :class:`InvalidInput` when none is stated."""
    speed = parameters.sound_speed or recording.sound_speed
    if speed is None:
        raise InvalidInput("sound_speed", "missing", f"{SOUND_SPEED}; the recording states none")
    return speed


def modes_of(recording: Recording, parameters: ReconstructionParameters) -> int:
    """Return the lateral modes an axis that take effect."""
    return parameters.modes or default_modes(recording.grid, recording.aperture)


def film_of(recording: Recording) -> str:
    """Return the response of the simulated film that recorded it, as the scan states it; "" where it does not."""
    return recording.provenance.get("film", "")


def begins_at(recording: Recording, parameters: ReconstructionParameters) -> float:
    """Return the time in s from the laser pulse to the first sample, trigger delay included."""
    return recording.time_zero + parameters.conditioning.delay


def extent_of(recording: Recording, parameters: ReconstructionParameters) -> Extent:
    """Return the range of depths that the record covers."""
    samples = recording.traces.shape[1]
    return Extent.of(samples, recording.sampling_interval, begins_at(recording, parameters))


def depth_range_of(recording: Recording, parameters: ReconstructionParameters) -> tuple[float, float] | None:
    """Return first and last depth in metres that take effect; None: all of the record."""
    if parameters.depth_range is None:
        return None
    first, last = parameters.depth_range
    extent = extent_of(recording, parameters)
    step = recording.sampling_interval * sound_speed_of(recording, parameters)
    end = (extent.end - 1) * step if last is None else last
    if first is None:
        first = extent.first * step if extent.first * step < end else 0.0
    return first, end


def weights_of(recording: Recording, parameters: ReconstructionParameters) -> NDArray[np.float64]:
    """Areas of the sensors' cells; all three choices sum to the same sensed area where the recording knows it."""
    positions, outline, own = recording.positions, recording.outline, recording.weights
    if parameters.weights == "mask" and own is not None:
        return own
    if outline is None:
        outline = sensed_region(positions, recording.aperture)
    if parameters.weights == "uniform":
        return np.full(len(positions), outlines.area(outline) / len(positions))
    return voronoi_cell_areas(positions, outline)
