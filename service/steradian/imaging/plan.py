"""The reconstruction plan: geometry once, many runs."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from steradian.errors import InvalidInput
from steradian.imaging import checks, memory
from steradian.imaging.blocks import blocks
from steradian.imaging.checks import Sensors
from steradian.imaging.factors import Transform, table_bytes, transform
from steradian.imaging.geometry import Geometry, geometry
from steradian.imaging.lateral import Lateral, filled, grid_of, gridded, non_uniform
from steradian.imaging.response import Correction, tabulated
from steradian.imaging.sizes import lateral_grid, time_grid
from steradian.imaging.volume import Volume
from steradian.imaging.windows import Shape, Window
from steradian.progress import IsCancelled, Progress
from steradian.ranges import real

Method: TypeAlias = Literal["nedner", "ner", "linear", "nearest", "interpolated"]
_PAD = 24  # cells repeated at either end of a spectrum (columns.PAD, which needs Numba to import)
_COLUMN_BYTES, _SAMPLE_BYTES = 290, 900  # of tables while a plan is made, for a lateral mode and for a sample, at least


class ReconstructionPlan:
    """Everything that depends on the sensors' geometry alone; :meth:`run` reconstructs traces with it.

    Parameters as in :func:`steradian.imaging.reconstruct`, and ``samples``, the number of samples N_t of a trace.

    Attributes
    ----------
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
        method: Method = "nedner",
        tolerance: float = 1e-4,
        window: Shape | Window = "kaiser-bessel",
        time_zero: float = 0.0,
        time_padding: float = 1.0,
        lateral_padding: float = 1.0,
        wrap: bool = False,
        correction: Correction | None = None,
        dtype: DTypeLike | None = None,
        memory_limit: int | None = None,
        threads: int | None = None,
    ) -> None:
        checks.choice("method", method, get_args(Method), "; iterative is for reconstruct()")
        if not isinstance(window, Window):
            checks.choice("window", window, get_args(Shape), ", or a Window")
        if not isinstance(correction, Correction | None):
            raise InvalidInput("correction", type(correction).__name__, "a Correction, or None")
        self.tolerance = checks.within("tolerance", tolerance, 1e-12, 0.1, "a relative error")
        self.dtype: str = checks.working_precision(dtype, self.tolerance)
        self.threads = checks.thread_count(threads)
        self.geometry: Geometry = geometry(
            positions,
            samples=samples,
            sampling_interval=sampling_interval,
            sound_speed=sound_speed,
            aperture=aperture,
            modes=modes,
            weights=weights,
            upsampling=upsampling,
            depth_range=depth_range,
            time_zero=time_zero,
            time_padding=time_padding,
            lateral_padding=lateral_padding,
            wrap=wrap,
        )
        g = self.geometry
        flat = len(g.modes) == 1
        self._modes = (1, g.padded_modes[0]) if flat else (g.padded_modes[0], g.padded_modes[1])
        self._memory_limit = memory_limit
        memory.require(self._least_bytes(), memory_limit, g.shape)
        places = g.places()
        if flat:
            places = np.concatenate([np.zeros_like(places), places], axis=1)
        self._prepare_lateral(places, method, window)
        self._prepare_time(window)
        self._filter = tabulated(
            correction, nyquist=0.5 / g.sampling_interval, bandwidth=0.5 * g.record, sound_speed=g.sound_speed
        )
        scales = [g.record * g.depth_step / X for X in g.period]
        both = (0.0, scales[0]) if flat else (scales[0], scales[1])
        norm = 0.5 / (float(np.prod(g.padded_modes)) * g.record)
        self._prepare_memory()
        memory.require(self.memory_bytes, memory_limit, g.shape)
        self._blocks = blocks(self._lateral, self._modes, both, norm, self.dtype)

    def _least_bytes(self) -> int:
        """Lower bound of what plan and run take, from numbers alone: nothing large has been made yet."""
        g = self.geometry
        columns = self._modes[0] * (self._modes[1] // 2 + 1)
        tables = columns * _COLUMN_BYTES + g.samples * _SAMPLE_BYTES
        tables += sum(table_bytes(n) for n in {g.record, *self._inverse_size()})
        image = max(2 * columns, prod(g.shape[:-1])) * g.shape[-1] * np.dtype(self.dtype).itemsize
        return max(tables, image)

    def _prepare_lateral(self, places: NDArray[np.float64], method: Method, window: Shape | Window) -> None:
        g = self.geometry
        point = float(np.prod([X / n for X, n in zip(g.period, g.padded_modes, strict=True)]))
        grid = grid_of(places, self._modes, 0.1 * self.tolerance)
        if method == "ner" and grid is None:
            raise InvalidInput("method", method, "nedner: the sensors are not on a grid that divides the aperture")
        self.method: Method = "ner" if method == "nedner" and grid is not None else method
        self._share = 0.4 * self.tolerance / np.sqrt(len(g.modes) + 1)
        if method == "interpolated":
            grid = grid or [(n, 0.0) for n in self._modes]
            cell = float(np.prod(g.period)) / (grid[0][0] * grid[1][0])
            self._lateral: Lateral = filled(places, cell / point, self._modes, grid, self.dtype)
        elif grid is not None:
            self._lateral = gridded(places, g.weights / point, self._modes, grid, self.dtype)
        else:
            sizes, found = lateral_grid(self._modes, len(places), window, self._share)
            windows = (None if self._modes[0] == 1 else found, found)
            self._lateral = non_uniform(places, g.weights / point, self._modes, windows, sizes, self.dtype)

    def _prepare_time(self, window: Shape | Window) -> None:
        g = self.geometry
        self._nearest = int(self.method == "nearest")
        if self.method in ("linear", "nearest"):
            # k-Wave's transform of the record's even extension has this spacing of frequencies
            self._centre, self._length, self._width = 0, 2 * g.record, 2 - self._nearest
            self._time_window = np.ones(g.samples, self.dtype)
            self._taps = np.array([[1.0]] if self._nearest else [[0.5, -0.5], [0.5, 0.5]], self.dtype)
        else:
            self._centre = g.samples // 2
            longest = 2 * max(self._centre, g.samples - self._centre)
            self._length, found = time_grid(longest, g.record, window, self._share)
            n = np.arange(g.samples) - self._centre
            self._time_window = (1.0 / found.transform(n / self._length)).astype(self.dtype)
            self._taps = found.polynomials(0.05 * self.tolerance).astype(self.dtype)
        self._turns = (self._centre + g.time_zero / g.sampling_interval) / g.record

    def _prepare_memory(self) -> None:
        g = self.geometry
        item = np.dtype(self.dtype).itemsize
        self._out_rows = prod(g.shape[:-1])
        depth = g.shape[-1]
        mode_rows = 2 * self._modes[0] * (self._modes[1] // 2 + 1)
        # where the modes' depths go: over their own times, or (replicated) to a place of their own
        self._source_rows = self._lateral.rows
        self._source_stride = g.samples if self._lateral.replicated else max(g.samples, depth)
        self._target_stride = depth if self._lateral.replicated else self._source_stride
        self._target_rows = mode_rows if self._lateral.replicated else self._source_rows
        # the image may overwrite the modes' depths, batch by batch
        self._shared = self._target_stride == depth and self._out_rows <= self._target_rows
        image = self._out_rows * depth * item
        target = (self._target_rows + 1) * self._target_stride * item
        source = (self._source_rows + 1) * self._source_stride * item if self._lateral.replicated else 0
        scratch = self._scratch_items() * item
        room = max(scratch, image // 2)
        self.threads = int(max(1, min(self.threads, room // max(scratch, 1))))
        self.output_bytes = image
        self._kept_bytes = target if self._shared else image
        # a source of its own is freed before the image is made
        self.memory_bytes = max(source + target, target + (0 if self._shared else image)) + self.threads * scratch

    def _scratch_items(self) -> int:
        g, (nx, ny) = self.geometry, self._lateral.grid
        line = max(nx, ny + 24)
        forward = len(self._lateral.spread.order) + 2 * line + 2 * len(self._lateral.ys) * nx
        big = max(self._inverse_size())
        middle = (g.shape[0] if len(g.modes) == 2 else 1) * self._inverse_size()[1]
        backward = 4 * big + middle
        return 32 * max(forward, backward, 2 * (max(self._length, g.record) + 2 * _PAD) + 200)

    def _inverse_size(self) -> tuple[int, int]:
        up = self.geometry.upsampling
        return (self._modes[0] * (up if self._modes[0] > 1 else 1), self._modes[1] * up)

    def run(
        self,
        traces: ArrayLike,
        *,
        scale: float = 1.0,
        progress: Progress | None = None,
        cancelled: IsCancelled | None = None,
    ) -> Volume | list[Volume]:
        """Reconstruct one set of traces, or several with the same sensors.

        Parameters
        ----------
        traces
            Shape (M, N_t), or (B, M, N_t); floating or integer.
        scale
            Multiplies the traces (pressure per count for integers).
        progress, cancelled
            See :mod:`steradian.progress`.

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
        from steradian.imaging.execute import execute

        g = self.geometry
        data = np.asarray(traces)
        if data.dtype.kind not in "iuf":
            raise InvalidInput("traces", f"an array of {data.dtype}", "integers or floating numbers")
        wanted = f"shape ({len(g.positions)}, {g.samples}): one row a sensor, one column a sample"
        if data.ndim not in (2, 3) or data.shape[-2:] != (len(g.positions), g.samples):
            raise InvalidInput("traces", f"an array of shape {data.shape}", wanted)
        scale = real("scale", scale, "a finite factor")
        images = len(data) if data.ndim == 3 else 1
        needed = self.memory_bytes + max(0, images - 1) * self._kept_bytes
        memory.require(needed, self._memory_limit, g.shape, images)
        if data.ndim == 3:
            return [self._one(execute, frame, scale, progress, cancelled) for frame in data]
        return self._one(execute, data, scale, progress, cancelled)

    def _one(
        self, execute: Any, data: NDArray[Any], scale: float, progress: Progress | None, cancelled: IsCancelled | None
    ) -> Volume:
        g = self.geometry
        if data.dtype not in (np.float32, np.float64, np.int16, np.int32):
            data = data.astype(np.int32 if data.dtype.kind in "iu" and data.dtype.itemsize < 4 else np.float64)
        values = execute(self, data, scale, progress, cancelled)
        return Volume(values.reshape(g.shape), g.axes(), g.spacing, g.sound_speed)

    def transforms(self) -> tuple[Transform, Transform, Transform, Transform, Transform, Transform]:
        """Tables: forward x, y; time; depth; inverse x, y."""
        nx, ny = self._lateral.grid
        ix, iy = self._inverse_size()
        tables = [transform(n, self.dtype) for n in (nx, ny, self._length, self.geometry.record, ix, iy)]
        return (tables[0], tables[1], tables[2], tables[3], tables[4], tables[5])
