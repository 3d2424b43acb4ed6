"""Linear map from images to A-lines at variable parameters, its transpose, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import SOUND_SPEED, TIME_ZERO
from steradian.imaging import validation as checks
from steradian.imaging.engines import run_forward, run_inverse
from steradian.imaging.engines.array_namespace import is_gpu_array, like, to_numpy
from steradian.imaging.engines.numba.engine import NumbaEngine
from steradian.imaging.engines.selection import AnyEngine, EngineSelector
from steradian.imaging.geometry.reconstruction import ReconstructionGeometry
from steradian.imaging.transform_tables import moved

Floats = NDArray[np.float64]
Factor: TypeAlias = Literal["none", "time", "faster", "slower"]
"""Factor of each wave: none; 2πif; and the film's response at a sound speed that is larger or smaller by STEP, instead
of the film's response."""
Product: TypeAlias = Literal["to_traces", "to_image"]
REACH = 1.05
"""Largest c·t of the last sample, in those of the geometry that the voxels are padded for."""
STEP = 1e-4
"""Relative step of the difference quotient of a film's response by the sound speed; it jumps at critical angles."""
QUOTIENT_STEP = {"float64": 2e-4, "float32": 2e-2}
"""Steps of difference quotients in media of several layers, in samples at the end of the record, by precision."""
_KEPT = 4  # engines for each parameter: those of one speed and time with each factor, or on both sides of it


@dataclass(frozen=True, eq=False)
class Parameters:
    """Sensor positions (M, d−1) in m, sound speeds of the L layers in m/s, and time of the first sample in s."""

    positions: Floats
    sound_speeds: tuple[float, ...]
    time_zero: float


@dataclass(frozen=True)
class Variation:
    """Way in which a map K depends on its parameters.

    Parameters
    ----------
    exponent
        ν: power of c that multiplies K.
    responding
        Whether waves have the response of a film.
    quotient
        Whether the derivatives by sound speeds and time zero are difference quotients: in layers the field at a
        boundary begins with the pulse, which a factor of each wave does not know.
    """

    exponent: int = 0
    responding: bool = False
    quotient: bool = False


class ParametricTransform:
    """Linear map K from images to A-lines, at any sensor positions, sound speed and time zero near those of a geometry.

    Parameters
    ----------
    geometry
        Sensors, voxels and timing where nothing else is given.
    make
        Function from sound speeds, time zero and a factor to an engine, with the sensors of ``geometry``.
    variation
        Way in which K depends on them.
    sound_speeds
        Of the layers, in m/s, where nothing else is given.
    """

    def __init__(
        self,
        geometry: ReconstructionGeometry,
        make: Callable[[tuple[float, ...], float, Factor], EngineSelector],
        variation: Variation,
        sound_speeds: tuple[float, ...],
    ) -> None:
        self.geometry, self._make, self.variation, self.sound_speeds = geometry, make, variation, sound_speeds
        self._kept: dict[tuple[tuple[float, ...], float, Factor], EngineSelector] = {}
        self._last: tuple[bytes, TransformAt] | None = None

    @property
    def volume_shape(self) -> tuple[int, ...]:
        """Shape of images, [x, y, z] ([x, z] in 2-D)."""
        return self.geometry.shape

    @property
    def trace_shape(self) -> tuple[int, int]:
        """Shape of A-lines, (M, N_t)."""
        return len(self.geometry.positions), self.geometry.samples

    def parameters(
        self, positions: ArrayLike | None = None, sound_speed: ArrayLike | None = None, time_zero: float | None = None
    ) -> Parameters:
        """Return validated parameters, those of the geometry where None is given; ``sound_speed`` has one per layer.

        Raises
        ------
        InvalidInput
            If a shape differs, a sensor is outside the aperture, a number is out of range, or a record reaches deeper
            than the voxels are padded for (:data:`REACH`).
        """
        g = self.geometry
        x = g.positions
        if positions is not None:
            x = np.array(positions, np.float64)
            if x.shape != g.positions.shape:
                raise InvalidInput("positions", f"an array of shape {x.shape}", f"shape {g.positions.shape}")
            sides = np.array(g.aperture) / 2 * (1 + checks.ROUNDING)
            if not (np.abs(x) <= sides).all():  # nor where a number is not finite
                reach = ", ".join(f"{1e3 * side / 2:.6g}" for side in g.aperture)
                raise InvalidInput("positions", f"a sensor at {1e3 * np.abs(x).max():.6g} mm", f"within ±{reach} mm")
        speeds, begins = self.sound_speeds, g.time_zero
        if sound_speed is not None:
            given = np.asarray(sound_speed, np.float64).ravel()
            if given.size != len(speeds):
                raise InvalidInput("sound_speed", f"{given.size} numbers", f"{len(speeds)}: one for each layer")
            speeds = tuple(SOUND_SPEED.check("sound_speed", float(each)) for each in given)
        if time_zero is not None:
            begins = TIME_ZERO.check("time_zero", float(time_zero))
        ratio = max(speed / own for speed, own in zip(speeds, self.sound_speeds, strict=True))
        length = g.samples * g.sampling_interval
        latest = REACH * (max(0.0, g.time_zero) + length)
        if ratio * (begins + length) > latest * (1 + 1e-9):
            if begins == g.time_zero:
                most = latest / (begins + length)
                raise InvalidInput("sound_speed", max(speeds), f"at most {most:.4g} times the geometry's")
            raise InvalidInput("time_zero", begins, f"at most {latest / ratio - length:.6g} s with these sound speeds")
        return Parameters(x, speeds, begins)

    def at(self, p: Parameters) -> TransformAt:
        """Return the map at parameters of :meth:`parameters`; that of the last ones is kept."""
        key = p.positions.tobytes() + np.array([*p.sound_speeds, p.time_zero]).tobytes()
        last = self._last  # another thread may replace it
        if last is None or last[0] != key:
            last = self._last = key, TransformAt(self, p)
        return last[1]

    def engine(self, p: Parameters, factor: Factor) -> EngineSelector:
        """Return the engine for sound speeds and time zero; the last ones are kept."""
        key = (p.sound_speeds, p.time_zero, factor)
        found = self._kept.get(key)
        if found is None:
            found = self._make(*key)
            self._kept = dict([*self._kept.items(), (key, found)][-_KEPT * (1 + len(self.sound_speeds)) :])
        return found


class TransformAt:
    """Map K at one set of parameters, its transpose Kᵀ, and their derivatives.

    Images have the shape [x, y, z] ([x, z] in 2-D), A-lines (M, N_t); NumPy's arrays, or CuPy's for arrays on a GPU.
    """

    def __init__(self, transform: ParametricTransform, parameters: Parameters) -> None:
        self._transform, self.parameters = transform, parameters

    @cached_property
    def times(self) -> Floats:
        """Times (N_t,) of the samples since the laser pulse, in s."""
        g = self._transform.geometry
        return np.asarray(self.parameters.time_zero + np.arange(g.samples) * g.sampling_interval)

    def to_traces(self, image: Any, *, factor: Factor = "none") -> Any:
        """Return K f, the A-lines of an image, with a factor of each wave."""
        return self._run(factor, image, lambda engine, given: run_forward(engine, given))

    def to_image(self, traces: Any, *, factor: Factor = "none") -> Any:
        """Return Kᵀ g, the image of A-lines, with a factor of each wave."""
        return self._run(factor, traces, lambda engine, given: run_inverse(engine, given))

    def positions_to_traces(self, image: Any) -> Any:
        """Return ∂(K f)/∂x_m in row m, per metre, shape (d−1, M, N_t): one for each lateral axis."""

        def work(engine: AnyEngine, given: Any) -> Any:
            modes = engine.to_depth_adjoint(engine.to_image_adjoint(given))
            found = [self._by_position(engine, axis).lateral_adjoint(modes, kept=True) for axis in self._axes]
            return np.stack(found) if isinstance(engine, NumbaEngine) else engine.backend.xp.stack(found)

        return self._run("none", image, work)

    def positions_to_image(self, traces: Any) -> Any:
        """Return the transpose of :meth:`positions_to_traces` for traces (d−1, M, N_t): an image."""

        def work(engine: AnyEngine, given: Any) -> Any:
            modes: Any = None
            for axis in self._axes:
                modes = self._by_position(engine, axis).lateral(given[axis], onto=modes)
            return engine.to_image(engine.to_depth(modes))

        return self._run("none", traces, work)

    def time_to_traces(self, image: Any) -> Any:
        """Return ∂(K f)/∂t₀, per second."""
        return self._by_time(image, "to_traces")

    def speeds_to_traces(self, image: Any, of_time: Any = None) -> Any:
        """Return ∂(K f)/∂c, per m/s, shape (L, M, N_t); ``of_time``: :meth:`time_to_traces`, where it is known."""
        if self._transform.variation.quotient:
            return self._by_layers(image, "to_traces")
        found = self.time_to_traces(image) if of_time is None else of_time
        return self._by_speed(found * self._row(found), image, "to_traces")

    def time_to_image(self, traces: Any) -> Any:
        """Return ∂(Kᵀ g)/∂t₀, per second."""
        return self._by_time(traces, "to_image")

    def speeds_to_image(self, traces: Any) -> Any:
        """Return ∂(Kᵀ g)/∂c, per m/s, one image for each layer."""
        if self._transform.variation.quotient:
            return self._by_layers(traces, "to_image")
        return self._by_speed(self.to_image(traces * self._row(traces), factor="time"), traces, "to_image")

    def _by_speed(self, found: Any, values: Any, product: Product) -> Any:
        variation, compute = self._transform.variation, getattr(self, product)
        if variation.exponent:
            found = found + variation.exponent * compute(values)
        if variation.responding:
            found = found + (compute(values, factor="faster") - compute(values, factor="slower")) / (2 * STEP)
        return found[None] / self.parameters.sound_speeds[0]

    def _by_layers(self, values: Any, product: Product) -> Any:
        p, found = self.parameters, []
        for i, speed in enumerate(p.sound_speeds):
            step = speed * self._step / self._transform.geometry.samples
            sides = [(*p.sound_speeds[:i], speed + h, *p.sound_speeds[i + 1 :]) for h in (step, -step)]
            found.append(self._quotient([replace(p, sound_speeds=each) for each in sides], values, product) / step)
        return np.stack(found)

    def _by_time(self, values: Any, product: Product) -> Any:
        if not self._transform.variation.quotient:
            return getattr(self, product)(values, factor="time")
        p, step = self.parameters, self._step * self._transform.geometry.sampling_interval
        sides = [replace(p, time_zero=p.time_zero + h) for h in (step, -step)]
        return self._quotient(sides, values, product) / step

    def _quotient(self, sides: list[Parameters], values: Any, product: Product) -> Any:
        """Return half the difference of a product at two sets of parameters."""
        more, less = (getattr(TransformAt(self._transform, each), product)(values) for each in sides)
        return (more - less) / 2

    @property
    def _step(self) -> float:
        return QUOTIENT_STEP[self._transform.engine(self.parameters, "none").engine.tables.dtype]

    def _row(self, other: Any) -> Any:
        return like(self.times.astype(other.dtype), other)

    def _by_position(self, engine: AnyEngine, axis: int) -> AnyEngine:
        return engine.with_sensors(moved(engine.tables, self.parameters.positions, axis))

    @property
    def _axes(self) -> range:
        return range(self.parameters.positions.shape[1])

    def _run(self, factor: Factor, values: Any, work: Callable[[AnyEngine, Any], Any]) -> Any:
        chosen = self._transform.engine(self.parameters, factor)
        array = chosen.as_engine_array("values", values)
        volume, traces = self._transform.volume_shape, self._transform.trace_shape
        if array.shape not in (volume, traces, (len(volume) - 1, *traces)):
            raise InvalidInput("values", f"an array of shape {array.shape}", f"shape {volume} or {traces}")

        def placed(engine: AnyEngine) -> Any:
            given = array
            if isinstance(engine, NumbaEngine):
                given = np.ascontiguousarray(to_numpy(array), engine.tables.dtype)
            x = self.parameters.positions
            if not np.array_equal(x, engine.tables.geometry.positions):
                engine = engine.with_sensors(moved(engine.tables, x))
            return work(engine, given)

        return chosen.run_with_fallback(placed, keep=is_gpu_array(values))
