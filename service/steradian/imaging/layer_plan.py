"""Plan of one layer: tables and engine of its image, and the inverse of the attenuation on the way from it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging import validation as checks
from steradian.imaging.compute import memory_limit as memory
from steradian.imaging.engines import NO_MONITOR, ProgressMonitor, run_inverse
from steradian.imaging.engines.array_namespace import like, to_numpy
from steradian.imaging.engines.numba.engine import NumbaEngine
from steradian.imaging.engines.selection import AnyEngine, EngineSelector
from steradian.imaging.geometry.reconstruction import ReconstructionGeometry
from steradian.imaging.medium import Medium
from steradian.imaging.options import Compute, DirectMethod, Precision
from steradian.imaging.signal.attenuation import Compensation, compensation_bytes
from steradian.imaging.transform_tables import inverse_tables

NOISE_GAIN_DEPTHS = 9
"""Depths of an image whose noise gain is reported."""


class LayerPlan:
    """Precomputed tables and engine of the image of one layer of the medium.

    Parameters
    ----------
    geometry
        Sensors, timing and voxels of the layer.
    medium
        Layers from the film to that one.
    method, dtype, compute
        Direct method, working precision and execution options.

    Attributes
    ----------
    tables, chosen
        Tables and engine selection (:mod:`steradian.imaging.engines`).
    compensation
        Inverse of the attenuation, applied to A-lines before all else; None for lossless layers.
    noise_gain
        Pairs of depth in m and noise gain of the last A-lines that were compensated.
    """

    def __init__(
        self, geometry: ReconstructionGeometry, medium: Medium, method: DirectMethod, dtype: Precision, compute: Compute
    ) -> None:
        self._medium = medium
        self.noise_gain: tuple[tuple[float, float], ...] = ()
        self.compensation: Compensation | None = None
        if medium.lossy:
            memory.check_memory(compensation_bytes(geometry.samples), compute.memory_limit, geometry.shape)
            interval, first = geometry.sampling_interval, geometry.time_zero
            self.compensation = Compensation(medium, samples=geometry.samples, interval=interval, time_zero=first)
        self.tables = inverse_tables(geometry, method, dtype)
        self.chosen = EngineSelector(self.tables, compute)

    def decimate(self, traces: NDArray[Any], watch: ProgressMonitor = NO_MONITOR) -> NDArray[Any]:
        """Return A-lines (K, N_t) resampled for the engine: fewer samples if ``max_frequency`` permits.

        Raises
        ------
        InvalidInput
            If a sample is not finite.
        """
        fewer = self.tables.decimation
        if fewer is None:
            return traces
        threads = self.chosen.engine.room.threads
        result = fewer.apply(traces, self.tables.dtype, threads=threads, **watch._asdict())
        if not np.isfinite(result).all():
            raise InvalidInput("traces", checks.describe_non_finite(traces), "finite numbers")
        return result

    def image(self, data: Any, scale: float, watch: ProgressMonitor, *, keep: bool) -> Any:
        """Return the layer's image of A-lines (M, N_t) times ``scale``, on the GPU if ``keep``."""
        if self.compensation is not None:
            found = self.compensation.held or self.compensation.restoration(to_numpy(data))
            dtype = self.tables.dtype
            data = data.astype(dtype) @ like(found.matrix.T.astype(dtype), data)
            self.noise_gain = self._noise_gain(found.noise_gain)

        def work(engine: AnyEngine) -> Any:
            if not isinstance(engine, NumbaEngine):  # it decimates by itself
                return run_inverse(engine, data, watch, scale=scale)
            traces = self.decimate(to_numpy(data), watch)
            if traces.dtype not in (np.float32, np.float64, np.int16, np.int32):
                small = traces.dtype.kind in "iu" and traces.dtype.itemsize < 4
                traces = traces.astype(np.int32 if small else np.float64)
            return run_inverse(engine, traces, watch, scale=scale)

        return self.chosen.run_with_fallback(work, keep=keep)

    def _noise_gain(self, gains: NDArray[np.float64]) -> tuple[tuple[float, float], ...]:
        """Return pairs of depth and noise gain over the layer's image, of sound along the normal."""
        g = self.tables.geometry
        times = g.time_zero + g.sampling_interval * np.arange(g.samples)
        reached = [self._medium.depth_at(max(0.0, float(time))) for time in times]
        depths = g.axes().z
        shown = np.linspace(depths[0], depths[-1], NOISE_GAIN_DEPTHS)
        return tuple((float(z), float(gain)) for z, gain in zip(shown, np.interp(shown, reached, gains), strict=True))
