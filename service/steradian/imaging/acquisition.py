"""Acquisition: A-lines with the sensors and the timing of their recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import SAMPLES, SAMPLING_INTERVAL, SOUND_SPEED, TIME_ZERO, as_finite_float
from steradian.imaging.medium import Layer, Medium
from steradian.imaging.validation import Sensors

GEOMETRY = ("dt", "medium", "t0", "weights", "sensitivity", "aperture", "wrap")
"""Fields that an acquisition and its geometry share, beside the sensors and the speed, which the medium has."""


@dataclass(frozen=True, eq=False, repr=False)
class AcquisitionGeometry:
    """Sensors and timing of a recording, without its A-lines.

    Parameters
    ----------
    sensors
        Positions in metres, shape (M, 2), or (M,) in 2-D; the origin is the centre of the aperture. Or a
        :class:`steradian.Mask`, which has weights and an aperture of its own.
    samples
        Samples N_t of an A-line.
    dt
        Sampling interval in seconds.
    sound_speed
        Speed of sound c in m/s; not with a ``medium`` of several layers, whose slowest speed it then is.
    medium
        Layers between film and object; None: one of ``sound_speed``.
    t0
        Time from the laser pulse to the first sample in seconds, within ±0.5 ms; negative: the record begins before
        the pulse. The image of a late record is that of the record with zeros in front, at about the cost of the
        record alone.
    weights
        Areas h_m of the sensors' cells in m² (lengths in m in 2-D), shape (M,); none may be negative. Their sum is the
        *sensed* area (the disc that an equi-steradian mask covers, N·pitch along an axis of a grid), not the
        aperture's. None: the mask's, else as "voronoi": the areas of the sensors' Voronoi cells within
        :func:`steradian.imaging.geometry.sensor_areas.sensed_region` (0.6 s for fifty thousand scattered sensors).
        Sensors at the same position add up. ``Gridded`` and ``Iterative`` do not use weights.
    sensitivity
        Relative sensitivities s of the sensors, shape (M,), from 0.001 to 1000: A-line m is s_m times the pressure, at
        the noise of all. They are part of the model of ``Iterative`` and of the forward operator; direct methods take
        insensitive sensors for less of the area, which their neighbours make up for
        (:mod:`steradian.imaging.geometry.sensor_sensitivity`). Not for ``Gridded``. None: 1.
    aperture
        Lateral period X in metres, one number or (X, Y); None: the mask's.
    wrap
        Accept sensors outside the aperture and map them into the periodic aperture.

    Raises
    ------
    InvalidInput
        If a number is out of range.
    """

    sensors: ArrayLike | Sensors
    samples: int
    _: KW_ONLY
    dt: float
    sound_speed: float = None  # type: ignore[assignment]  # set by __post_init__
    medium: Medium = None  # type: ignore[assignment]
    t0: float = 0.0
    weights: ArrayLike | Literal["voronoi"] | None = None
    sensitivity: ArrayLike | None = None
    aperture: float | Sequence[float] | None = None
    wrap: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "samples", SAMPLES.check_integer("samples", self.samples))
        _check_timing(self)

    def __repr__(self) -> str:
        count = len(self.sensors.positions if isinstance(self.sensors, Sensors) else np.asarray(self.sensors))
        return f"<AcquisitionGeometry: {count:,} sensors, {_timing(self, self.samples)}>"

    def acquisition(self, traces: ArrayLike, *, scale: float = 1.0) -> Acquisition:
        """Return the acquisition of A-lines (M, N_t) with these sensors and this timing.

        Raises
        ------
        InvalidInput
            If ``traces`` does not have two axes, or ``scale`` is not a finite number.
        """
        shared = {name: getattr(self, name) for name in GEOMETRY}
        return Acquisition(traces, self.sensors, scale=scale, **shared)


@dataclass(frozen=True, eq=False, repr=False)
class Acquisition:
    """A-lines with the sensors and the timing of their recording.

    Parameters
    ----------
    traces
        A-lines, shape (M, N_t), floating or integer; column n was recorded at ``t0`` + n·``dt``. Of an array on a GPU
        (CuPy's, PyTorch's, with ``Compute(device="gpu")``) the image is an array of CuPy.
    sensors, dt, sound_speed, medium, t0, weights, sensitivity, aperture, wrap
        As in :class:`AcquisitionGeometry`.
    scale
        Factor of the traces (pressure per count for integers).

    Raises
    ------
    InvalidInput
        If ``traces`` does not have two axes, or a number is out of range.
    """

    traces: ArrayLike
    sensors: ArrayLike | Sensors
    _: KW_ONLY
    dt: float
    sound_speed: float = None  # type: ignore[assignment]  # set by __post_init__
    medium: Medium = None  # type: ignore[assignment]
    t0: float = 0.0
    scale: float = 1.0
    weights: ArrayLike | Literal["voronoi"] | None = None
    sensitivity: ArrayLike | None = None
    aperture: float | Sequence[float] | None = None
    wrap: bool = False

    def __post_init__(self) -> None:
        traces: Any = self.traces if hasattr(self.traces, "shape") else np.asarray(self.traces)
        if traces.ndim != 2:
            raise InvalidInput("traces", f"an array of shape {tuple(traces.shape)}", "shape (M, N_t): one row a sensor")
        object.__setattr__(self, "traces", traces)
        object.__setattr__(self, "scale", as_finite_float("scale", self.scale, "a finite factor"))
        _check_timing(self)

    def __repr__(self) -> str:
        count, samples = np.shape(self.traces)
        return f"<Acquisition: {count:,} A-lines, {_timing(self, samples)}>"

    @property
    def geometry(self) -> AcquisitionGeometry:
        """Sensors and timing, without the A-lines; raises :class:`InvalidInput` for records under 4 samples."""
        shared = {name: getattr(self, name) for name in GEOMETRY}
        return AcquisitionGeometry(self.sensors, np.shape(self.traces)[1], **shared)


def _check_timing(value: Acquisition | AcquisitionGeometry) -> None:
    for name, limits in (("dt", SAMPLING_INTERVAL), ("t0", TIME_ZERO)):
        object.__setattr__(value, name, limits.check(name, getattr(value, name)))
    speed: Any = value.sound_speed
    medium: Any = value.medium
    if medium is None:
        medium = Medium([Layer(SOUND_SPEED.check("sound_speed", speed))])
    elif not isinstance(medium, Medium):
        raise InvalidInput("medium", type(medium).__name__, "a Medium, or None with a sound_speed")
    elif speed is not None and speed != medium.slowest:
        raise InvalidInput("sound_speed", speed, f"none beside a medium ({medium})")
    object.__setattr__(value, "medium", medium)
    object.__setattr__(value, "sound_speed", medium.slowest)


def _timing(value: Acquisition | AcquisitionGeometry, samples: int) -> str:
    return f"{samples} samples every {1e9 * value.dt:g} ns, {value.medium}"
