"""The reconstruction plan: geometry once, many runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.core.units import as_finite_float
from steradian.imaging import validation as checks
from steradian.imaging.compute import memory_limit as memory
from steradian.imaging.engines import NO_MONITOR, ProgressMonitor, run_inverse
from steradian.imaging.engines.array_namespace import is_gpu_array, to_numpy
from steradian.imaging.engines.numba.engine import NumbaEngine
from steradian.imaging.engines.numba.memory_plan import min_bytes
from steradian.imaging.engines.selection import AnyEngine, EngineSelector
from steradian.imaging.film_response import InverseFilter
from steradian.imaging.geometry.reconstruction import ReconstructionGeometry, geometry
from steradian.imaging.parameters import Device, DirectMethod, Method, Parameters
from steradian.imaging.tables import TransformTables, inverse_tables
from steradian.imaging.transforms.windows import Shape, Window
from steradian.imaging.validation import Sensors
from steradian.imaging.volume import Volume


class ReconstructionPlan:
    """Everything that depends on the sensors' geometry alone; :meth:`run` reconstructs traces with it.

    Parameters as in :func:`steradian.imaging._reconstruct`, and ``samples``, the number of samples N_t of a trace.

    Attributes
    ----------
    parameters
        What was chosen.
    tables, chosen, engine
        What is computed, which engine was chosen for it, and that (:mod:`steradian.imaging.engines`).
    geometry
        The checked geometry, with ``shape``, ``spacing`` and ``axes()`` of the image to come.
    method
        As asked for, or "ner" where the sensors were found on a grid.
    dtype
        Working precision.
    threads
        Threads a run uses (fewer than asked for if their scratch space would exceed half of the image).
    output_bytes, memory_bytes
        Size of the image, and bound of what a run of one set of traces allocates, image included, traces not. (Traces
        that are not C-contiguous, or of an integer type other than int16 and int32, are copied first.)

    Raises
    ------
    InvalidInput
        If a parameter is out of range, or the memory needed exceeds ``memory_limit``, or what is available.
    """

    def __init__(
        self,
        positions: ArrayLike | Sensors,
        *,
        samples: int,
        sampling_interval: float,
        sound_speed: float,
        aperture: float | Sequence[float] | None = None,
        modes: int | Sequence[int],
        weights: ArrayLike | Literal["voronoi"] | None = None,
        upsampling: int = 1,
        depth_range: tuple[float, float] | None = None,
        method: DirectMethod = "nedner",
        tolerance: float = 1e-4,
        window: Shape | Window = "kaiser-bessel",
        time_zero: float = 0.0,
        time_padding: float = 1.0,
        lateral_padding: float = 1.0,
        wrap: bool = False,
        highest_frequency: float | None = None,
        depth_step: float | None = None,
        correction: InverseFilter | None = None,
        dtype: DTypeLike | None = None,
        memory_limit: int | None = None,
        threads: int | None = None,
        device: Device = "cpu",
        device_memory: int | None = None,
    ) -> None:
        self.parameters = Parameters(
            sampling_interval=sampling_interval, sound_speed=sound_speed, aperture=aperture, modes=modes,
            weights=weights, upsampling=upsampling, depth_range=depth_range, method=method, tolerance=tolerance,
            window=window, time_zero=time_zero, time_padding=time_padding, lateral_padding=lateral_padding, wrap=wrap,
            highest_frequency=highest_frequency, depth_step=depth_step, correction=correction, dtype=dtype,
            memory_limit=memory_limit, threads=threads, device=device, device_memory=device_memory,
        )  # fmt: skip
        self.tables, self.chosen = _build(positions, samples, self.parameters)

    @classmethod
    def from_parameters(cls, positions: ArrayLike | Sensors, samples: int, parameters: Parameters) -> Self:
        """Create a plan from parameters as one value."""
        plan = cls.__new__(cls)
        plan.parameters = parameters
        plan.tables, plan.chosen = _build(positions, samples, parameters)
        return plan

    @property
    def engine(self) -> AnyEngine:
        """Name of the engine in use."""
        return self.chosen.engine

    @property
    def geometry(self) -> ReconstructionGeometry:
        """The checked geometry."""
        return self.tables.geometry

    @property
    def method(self) -> Method:
        """The method used."""
        return self.tables.method

    @property
    def dtype(self) -> str:
        """Working precision."""
        return self.tables.dtype

    @property
    def threads(self) -> int:
        """Threads a run uses."""
        return self.engine.room.threads

    @property
    def output_bytes(self) -> int:
        """Size of the image."""
        return self.engine.room.output_bytes

    @property
    def memory_bytes(self) -> int:
        """Upper bound of the memory that a run allocates."""
        return self.engine.room.memory_bytes

    def run(
        self,
        traces: ArrayLike,
        *,
        scale: float = 1.0,
        progress: Progress | None = None,
        cancelled: CancelCheck | None = None,
    ) -> Volume | list[Volume]:
        """Reconstruct one set of traces, or several with the same sensors.

        Parameters
        ----------
        traces
            Shape (M, N_t), or (B, M, N_t); floating or integer.
        scale
            Multiplies the traces (pressure per count for integers).
        progress, cancelled
            See :mod:`steradian.core.progress`.

        Returns
        -------
        Volume
            A list of B volumes for traces with three axes.

        Raises
        ------
        InvalidInput
            If the shape does not fit, a sample is not finite, or all images together exceed the plan's
            ``memory_limit``, or what is available by now.
        Cancelled
            If ``cancelled`` said so.
        """
        g = self.geometry
        data = self.chosen.as_engine_array("traces", traces)
        if data.dtype.kind not in "iuf":
            raise InvalidInput("traces", f"an array of {data.dtype}", "integers or floating numbers")
        sensors = len(g.positions)
        if data.ndim not in (2, 3) or data.shape[-2:] != (sensors, g.samples):
            wanted = f"shape ({sensors}, {g.samples}): one row a sensor, one column a sample"
            if data.ndim > 1 and data.shape[-1] == sensors != data.shape[-2]:
                wanted = f"one row for each of the {sensors} sensors; this has a column for each: transpose it"
            raise InvalidInput("traces", f"an array of shape {data.shape}", wanted)
        scale = as_finite_float("scale", scale, "a finite factor")
        images = len(data) if data.ndim == 3 else 1
        needed = self.memory_bytes + max(0, images - 1) * self.engine.room.kept_bytes
        memory.check_memory(needed, self.parameters.memory_limit, g.shape, images)
        watch = ProgressMonitor(progress, cancelled)
        if data.ndim == 3:
            return [self._one(frame, scale, watch, is_gpu_array(traces)) for frame in data]
        return self._one(data, scale, watch, is_gpu_array(traces))

    def decimate(self, traces: NDArray[Any], watch: ProgressMonitor = NO_MONITOR) -> NDArray[Any]:
        """Return A-lines (K, N_t) with the samples that the engine takes: fewer where ``highest_frequency`` allows.

        Raises
        ------
        InvalidInput
            If a sample is not finite.
        """
        fewer = self.tables.decimation
        if fewer is None:
            return traces
        result = fewer.apply(traces, self.dtype, threads=self.threads, **watch._asdict())
        if not np.isfinite(result).all():
            raise InvalidInput("traces", checks.describe_non_finite(traces), "finite numbers")
        return result

    def _one(self, data: Any, scale: float, watch: ProgressMonitor, keep: bool) -> Volume:
        def work(engine: AnyEngine) -> Any:
            if not isinstance(engine, NumbaEngine):  # it decimates by itself
                return run_inverse(engine, data, watch, scale=scale)
            traces = self.decimate(to_numpy(data), watch)
            if traces.dtype not in (np.float32, np.float64, np.int16, np.int32):
                small = traces.dtype.kind in "iu" and traces.dtype.itemsize < 4
                traces = traces.astype(np.int32 if small else np.float64)
            return run_inverse(engine, traces, watch, scale=scale)

        g = self.geometry
        return Volume(self.chosen.run_with_fallback(work, keep=keep), g.axes(), g.spacing, g.sound_speed)


def _build(positions: ArrayLike | Sensors, samples: int, chosen: Parameters) -> tuple[TransformTables, EngineSelector]:
    checks.check_choice("method", chosen.method, get_args(DirectMethod), "; iterative is for reconstruct()")
    found = geometry(positions, samples, chosen)
    memory.check_memory(min_bytes(found, chosen.precision), chosen.memory_limit, found.shape)
    tables = inverse_tables(found, chosen)
    return tables, EngineSelector(tables, chosen)
