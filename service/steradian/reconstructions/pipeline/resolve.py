"""Resolution of request parameters to library arguments, with defaults from the recording."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import SOUND_SPEED
from steradian.imaging import (
    AcquisitionGeometry,
    Compute,
    DirectMethod,
    ImageGrid,
    Iterative,
    IterativeOptions,
    Layer,
    Medium,
    Method,
)
from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.geometry.sensor_areas import sensed_region
from steradian.imaging.geometry.voronoi import voronoi_cell_areas
from steradian.imaging.options import DIRECT_METHODS
from steradian.imaging.signal.conditioning import Conditioning
from steradian.reconstructions.medium_parameters import build_medium, with_speeds
from steradian.reconstructions.parameters import ReconstructionParameters, default_modes
from steradian.scans.recording import Recording

REQUEST_FIELDS = {
    "depth": "depth_range",
    "max_frequency": "highest_frequency",
    "dt": "sampling_interval",
    "t0": "time_zero",
    "sensors": "positions",
}
"""Fields of requests, by the name of the same quantity in the library."""


def effective_parameters(recording: Recording, parameters: ReconstructionParameters) -> dict[str, Any]:
    """Return the parameters in effect, with defaults filled in from the recording."""
    decided: dict[str, Any] = {"modes": modes_of(recording, parameters)}
    if parameters.medium is None:
        decided["sound_speed"] = sound_speed_of(recording, parameters)
    else:
        layers = with_speeds(parameters.medium, recording.sound_speed)
        decided["medium"] = [layer.model_dump(mode="json") for layer in layers]
    return parameters.model_dump(mode="json") | decided


def preprocess(
    recording: Recording, parameters: ReconstructionParameters, *, divided: bool = True
) -> NDArray[np.float32]:
    """Return A-lines (M, N_t) in units of pressure after the conditioning that the parameters request.

    Unless ``divided``, those of a recording with sensitivities are as the sensors recorded them.
    """
    scale = np.asarray(recording.scale, np.float32).reshape(-1, 1)
    if not divided and recording.sensitivity is not None:
        scale = scale * recording.sensitivity[:, None].astype(np.float32)
    traces: NDArray[np.float32] = np.multiply(recording.traces, scale, dtype=np.float32)
    if parameters.conditioning == Conditioning():
        return traces
    return parameters.conditioning.apply(
        traces, recording.positions, sampling_interval=recording.sampling_interval, aperture=recording.aperture
    )


class ReconstructionSetup(NamedTuple):
    """Arguments of a reconstruction other than the A-lines."""

    geometry: AcquisitionGeometry
    grid: ImageGrid
    method: Method
    compute: Compute


def resolve_setup(recording: Recording, parameters: ReconstructionParameters) -> ReconstructionSetup:
    """Return the reconstruction arguments for request parameters and a recording.

    Raises
    ------
    InvalidInput
        When a parameter does not fit the recording; it names the field of the request.
    """
    with request_field_names():
        return ReconstructionSetup(
            AcquisitionGeometry(
                recording.positions,
                recording.traces.shape[1],
                dt=recording.sampling_interval,
                medium=medium_of(recording, parameters),
                t0=begins_at(recording, parameters),
                weights=weights_of(recording, parameters),
                aperture=recording.aperture,
            ),
            ImageGrid(
                modes_of(recording, parameters),
                depth=depth_range_of(recording, parameters),
                depth_step=parameters.depth_step,
                upsampling=parameters.upsampling,
                lateral_padding=parameters.lateral_padding,
                time_padding=parameters.time_padding,
            ),
            method_of(recording, parameters),
            Compute(device=parameters.device),
        )


def method_of(recording: Recording, parameters: ReconstructionParameters) -> Method:
    """Return the reconstruction method with its options."""
    correction = parameters.film.correction(film_of(recording))
    if parameters.method == "iterative":
        if parameters.window != DirectMethod.window:
            allowed = f"{DirectMethod.window} with the method iterative, which uses no other"
            raise InvalidInput("window", parameters.window, allowed)
        options = {field.name: getattr(parameters.iterative, field.name) for field in fields(IterativeOptions)}
        return Iterative(**options, tolerance=parameters.tolerance, correction=correction)
    return DIRECT_METHODS[parameters.method](
        tolerance=parameters.tolerance,
        window=parameters.window,
        max_frequency=parameters.highest_frequency,
        correction=correction,
    )


@contextmanager
def request_field_names() -> Iterator[None]:
    """Context manager that renames the library's fields in :class:`InvalidInput` to those of requests."""
    try:
        yield
    except InvalidInput as error:
        name, bracket, index = error.field.partition("[")
        if name not in REQUEST_FIELDS:
            raise
        raise InvalidInput(f"{REQUEST_FIELDS[name]}{bracket}{index}", error.value, error.allowed) from error


def medium_of(recording: Recording, parameters: ReconstructionParameters) -> Medium:
    """Return the effective medium; raises :class:`InvalidInput` when a speed of sound is not stated."""
    if parameters.medium is not None:
        return build_medium(parameters.medium, recording.sound_speed)
    speed = parameters.sound_speed or recording.sound_speed
    if speed is None:
        raise InvalidInput("sound_speed", "missing", f"{SOUND_SPEED}; the recording states none")
    return Medium([Layer(SOUND_SPEED.check("sound_speed", speed))])


def sound_speed_of(recording: Recording, parameters: ReconstructionParameters) -> float:
    """Return the effective speed of sound in m/s, with layers that of the slowest; raises as :func:`medium_of`."""
    return medium_of(recording, parameters).slowest


def modes_of(recording: Recording, parameters: ReconstructionParameters) -> int:
    """Return the number of lateral modes per axis in effect."""
    return parameters.modes or default_modes(recording.grid, recording.aperture)


def film_of(recording: Recording) -> str:
    """Return the simulated film response that the scan states; "" if the scan states none."""
    return recording.provenance.get("film", "")


def begins_at(recording: Recording, parameters: ReconstructionParameters) -> float:
    """Return the time in s from the laser pulse to the first sample, trigger delay included."""
    return recording.time_zero + parameters.conditioning.delay


def extent_of(recording: Recording, parameters: ReconstructionParameters) -> Extent:
    """Return the range of depths that the A-lines cover."""
    samples = recording.traces.shape[1]
    with request_field_names():
        return Extent.of(samples, recording.sampling_interval, begins_at(recording, parameters))


def depth_range_of(recording: Recording, parameters: ReconstructionParameters) -> tuple[float, float] | None:
    """Return the first and last depth in metres in effect; ``None`` for the whole record."""
    if parameters.depth_range is None:
        return None
    first, last = parameters.depth_range
    extent, medium = extent_of(recording, parameters), medium_of(recording, parameters)
    end = medium.depth_at((extent.end - 1) * recording.sampling_interval) if last is None else last
    if first is None:
        begin = medium.depth_at(extent.first * recording.sampling_interval)
        first = begin if begin < end else 0.0
    return first, end


def weights_of(recording: Recording, parameters: ReconstructionParameters) -> NDArray[np.float64]:
    """Return the sensor weights (areas): from the mask, uniform or Voronoi; all sum to the sensed area if known."""
    positions, outline, own = recording.positions, recording.outline, recording.weights
    if parameters.weights == "mask" and own is not None:
        return own
    if outline is None:
        outline = sensed_region(positions, recording.aperture)
    if parameters.weights == "uniform":
        return np.full(len(positions), outlines.area(outline) / len(positions))
    return voronoi_cell_areas(positions, outline)
