"""Reconstruction plan: tables for one geometry, reusable for many recordings."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.core.quantity_ranges import as_finite_float
from steradian.imaging.acquisition import AcquisitionGeometry
from steradian.imaging.compute import memory_limit as memory
from steradian.imaging.engines import NO_MONITOR, ProgressMonitor
from steradian.imaging.engines.array_namespace import is_gpu_array
from steradian.imaging.engines.numba.memory_plan import min_bytes
from steradian.imaging.engines.selection import AnyEngine, EngineSelector
from steradian.imaging.geometry.layers import resolve_layers
from steradian.imaging.geometry.reconstruction import ReconstructionGeometry
from steradian.imaging.layer_plan import LayerPlan
from steradian.imaging.medium import Medium
from steradian.imaging.options import Compute, DirectMethod, ImageGrid, Nufft, require_direct
from steradian.imaging.signal.attenuation import compensation_bytes
from steradian.imaging.transform_tables import TransformTables
from steradian.imaging.volume import ReconstructionInfo, Volume


class ReconstructionPlan:
    """Precomputed tables of a direct reconstruction for one geometry; :meth:`run` applies them to A-lines.

    Parameters
    ----------
    geometry
        Sensors and timing.
    grid
        Voxels of the image.
    method
        Direct method; its ``max_frequency`` is a number or None, because a plan has no A-lines to find the signal in.
    compute
        Execution options.

    Attributes
    ----------
    acquisition, grid, options, compute
        The arguments.
    layers
        Plans of the layers in the image's depth range, from the film downwards; one without layers.

    Raises
    ------
    InvalidInput
        If a parameter is out of range, or the memory needed exceeds ``memory_limit``, or what is available.
    """

    def __init__(
        self,
        geometry: AcquisitionGeometry,
        grid: ImageGrid,
        method: DirectMethod = Nufft(),
        *,
        compute: Compute = Compute(),
    ) -> None:
        require_direct(method, "; Iterative is for reconstruct()")
        self.acquisition, self.grid, self.options, self.compute = geometry, grid, method, compute
        dtype = compute.precision(method.tolerance)
        shapes = resolve_layers(geometry, grid, method.max_frequency)
        if len(geometry.medium.layers) > 1 and method.name not in ("ner", "nedner"):
            raise InvalidInput("method", method.name, "ner or nedner for a medium of several layers")
        if geometry.sensitivity is not None and method.name == "interpolated":
            raise InvalidInput("sensitivity", "an array", f"None with the method {method.name}: divide the A-lines")
        for shape in shapes:
            memory.check_memory(min_bytes(shape, dtype), compute.memory_limit, shape.shape)
        self.layers = [
            LayerPlan(shape, shape.path.medium if shape.path else geometry.medium, method, dtype, compute)
            for shape in shapes
        ]
        self._geometry = replace(shapes[0], depth=(shapes[0].depth[0], shapes[-1].depth[1]), path=None)

    @property
    def tables(self) -> TransformTables:
        """Tables of the first layer."""
        return self.layers[0].tables

    @property
    def chosen(self) -> EngineSelector:
        """Engine selection of the first layer."""
        return self.layers[0].chosen

    @property
    def engine(self) -> AnyEngine:
        """Compute engine in use (CPU or GPU)."""
        return self.chosen.engine

    @property
    def geometry(self) -> ReconstructionGeometry:
        """Validated geometry, with ``shape``, ``spacing`` and ``axes()`` of the image."""
        return self._geometry

    @property
    def method(self) -> str:
        """Name of the method in use: "ner" instead of "nedner" if the sensors are on a grid."""
        return self.tables.method

    @property
    def dtype(self) -> str:
        """Working precision: "float32" or "float64"."""
        return self.tables.dtype

    @property
    def threads(self) -> int:
        """Number of threads of a run; fewer than requested if scratch memory would exceed half of image or modes."""
        return self.engine.room.threads

    @property
    def output_bytes(self) -> int:
        """Size of the image in bytes."""
        return sum(layer.chosen.engine.room.output_bytes for layer in self.layers)

    @property
    def memory_bytes(self) -> int:
        """Upper bound of the memory in bytes that a run of one set of A-lines allocates, image included.

        Traces are not included. Those that are not C-contiguous, or of an integer type other than int16 and int32, are
        copied first.
        """
        largest = max(layer.chosen.engine.room.memory_bytes for layer in self.layers)
        if self.acquisition.medium.lossy:
            samples, item = self.geometry.samples, np.dtype(self.dtype).itemsize
            largest += 3 * len(self.geometry.positions) * samples * item + compensation_bytes(samples) * len(
                self.layers
            )
        return largest + (2 * self.output_bytes if len(self.layers) > 1 else 0)

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
        needed = self.memory_bytes + max(0, images - 1) * sum(
            layer.chosen.engine.room.kept_bytes for layer in self.layers
        )
        memory.check_memory(needed, self.compute.memory_limit, g.shape, images)
        watch = ProgressMonitor(progress, cancelled)
        if data.ndim == 3:
            return [self._one(frame, scale, watch, is_gpu_array(traces)) for frame in data]
        return self._one(data, scale, watch, is_gpu_array(traces))

    def __call__(self, traces: ArrayLike) -> Volume | list[Volume]:
        """Reconstruct by :meth:`run` with its defaults."""
        return self.run(traces)

    def decimate(self, traces: NDArray[Any], watch: ProgressMonitor = NO_MONITOR) -> NDArray[Any]:
        """Return A-lines (K, N_t) resampled for the engine (:meth:`LayerPlan.decimate`)."""
        return self.layers[0].decimate(traces, watch)

    def _one(self, data: Any, scale: float, watch: ProgressMonitor, keep: bool) -> Volume:
        if len(self.layers) == 1:
            return self.as_volume(self.layers[0].image(data, scale, watch, keep=keep))
        images = []
        for number, layer in enumerate(self.layers, start=1):
            part = watch.of_layer(number, len(self.layers))
            images.append(layer.image(data, scale, part, keep=keep))
        return self.as_volume(np.concatenate(images, axis=-1))

    def as_volume(self, values: Any) -> Volume:
        """Return an image [x, (y,) z] of this plan as :class:`Volume`, with coordinates and reconstruction info."""
        g, used = self.geometry, self.chosen
        notes = [note for layer in self.layers for note in layer.chosen.notes]
        notes += hidden_angles(self.acquisition.medium)
        noise_gain = tuple(pair for layer in self.layers for pair in layer.noise_gain)
        if noise_gain:
            ends = " to ".join(f"{gain:.2g} at {1e3 * depth:.3g} mm" for depth, gain in (noise_gain[0], noise_gain[-1]))
            notes.append(f"attenuation was compensated, with a noise gain of {ends}")
        info = ReconstructionInfo(
            self.method, used.device, tuple(notes), g.highest_frequency, memory_bytes=self.memory_bytes,
            noise_gain=noise_gain,
        )  # fmt: skip
        return Volume(values, g.axes(), g.spacing, g.sound_speed, info)


def hidden_angles(medium: Medium) -> list[str]:
    """Return a note for each layer from which sound beyond a critical angle does not reach the film."""
    notes = []
    for path in medium.layer_paths():
        if path.critical_angle is not None:
            where = f"the layer from {1e3 * path.top:.4g} mm ({path.sound_speed:g} m/s)"
            notes.append(f"sound of {where} beyond {path.critical_angle:.0f}° to the normal does not reach the film")
    return notes
