"""Default CPU engine: its memory, and the six transform steps in chunks on threads."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.compute import memory_limit as memory
from steradian.imaging.compute import thread_pool as workers
from steradian.imaging.engines import NO_MONITOR, ProgressMonitor
from steradian.imaging.engines.numba.constants import BATCH, CELL_PADDING, DEPTH_CHUNK
from steradian.imaging.engines.numba.fft_tables import FftTables, transform
from steradian.imaging.engines.numba.kernel_args import (
    AxisTransform,
    Batch,
    DepthWorkspace,
    ImagePlane,
    Sensors,
    StoredModes,
    Workspace,
)
from steradian.imaging.engines.numba.kernel_tables import (
    all_stored,
    image_points_as_sensors,
    kappa_map,
    sensors_of,
    stored_modes,
    subset,
)
from steradian.imaging.engines.numba.memory_plan import MemoryPlan, aligned_empty, plan_memory, round_up_to_vector
from steradian.imaging.engines.numba.mode_blocks import ModeBlocks, group_modes
from steradian.imaging.transform_tables import TransformTables
from steradian.imaging.transforms.lateral import LateralTransform
from steradian.imaging.validation import MAX_EXPONENT, describe_non_finite
from steradian.imaging.volume import RealArray

if TYPE_CHECKING:
    from steradian.imaging.engines import Engine

_BLOCKS = 32  # most blocks of columns a piece of work has
SMALL_WORK_BYTES = (
    1 << 21
)  # numbers that the caches hold, and for which waiting for a second thread costs more than it saves
PAGE_BYTES, PREFAULT_BYTES = 1 << 12, 1 << 24  # bytes of a page, at least, and of what a thread brings in at a time
_NONE = np.empty(0)
WorkFunction = Callable[[int, Any, NDArray[np.uint8]], None]


class NumbaEngine:
    """:class:`~steradian.imaging.engines.Engine` of compiled CPU kernels; modes are rows of one flat array.

    Parameters
    ----------
    tables
        What to compute.
    threads
        At most.
    memory_limit
        See :func:`steradian.imaging.compute.memory_limit.check_memory`.

    Attributes
    ----------
    tables
        As given.
    room
        Memory, and the threads that it allows.

    Raises
    ------
    InvalidInput
        If the memory needed exceeds the limit, or what is available.
    """

    def __init__(self, tables: TransformTables, *, threads: int, memory_limit: int | None = None) -> None:
        self.tables = tables
        self._stored = stored_modes(tables.lateral, edges=not tables.transposable)
        self.room: MemoryPlan = plan_memory(tables, self._stored, threads)
        memory.check_memory(self.room.memory_bytes, memory_limit, tables.geometry.shape)
        self._sensors = sensors_of(tables.lateral, tables.dtype)
        self._blocks: ModeBlocks = group_modes(tables, self._stored)
        numbers = max(self.room.target_rows * tables.depths, self.room.output_bytes // np.dtype(tables.dtype).itemsize)
        self._large = numbers >= SMALL_WORK_BYTES
        self._threads = self.room.threads if self._large else 1

    def lateral(
        self,
        traces: Any,
        watch: ProgressMonitor = NO_MONITOR,
        *,
        scale: float = 1.0,
        sensors: NDArray[Any] | None = None,
        onto: Any = None,
    ) -> RealArray:
        """Return the lateral modes of traces (NUFFT type 1); traces of float32, float64, int16 or int32."""
        target = self._empty(self.room.source_size) if onto is None else onto
        chosen = self._sensors if sensors is None else subset(self._sensors, sensors)
        with np.errstate(over="ignore"):  # such traces are refused
            chosen = chosen._replace(scale=(chosen.scale * scale).astype(self.tables.dtype))
        plane = self._plane(self.tables.lateral.grid)
        self._type1("lateral transform", traces, chosen, plane, self._stored, target, watch, add=onto is not None)
        return target

    def to_depth(self, modes: RealArray, watch: ProgressMonitor = NO_MONITOR, *, kept: bool = False) -> RealArray:
        """Return the modes over depth, by interpolation of the time spectrum at κ."""
        from steradian.imaging.engines.numba.depth import to_depth

        target = modes
        if kept or self.tables.lateral.replicated:
            target = self._empty(self.room.target_size)
        self._columns("time to depth", to_depth, modes, target, watch)
        return target

    def to_image(self, modes: RealArray, watch: ProgressMonitor = NO_MONITOR) -> RealArray:
        """Return the image of modes over depth, by inverse FFT and, if requested, upsampling."""
        from steradian.imaging.engines.numba.modes_to_image import compact_rows, to_image

        t, shape, depths = self.tables, self.tables.geometry.shape, self.tables.depths
        lines, pitch = int(np.prod(shape[:-1])), round_up_to_vector(depths)
        image = modes if self.room.shared else self._empty(lines * pitch)
        plane = self._plane(t.image_modes)

        def work(piece: int, space: Workspace, flag: NDArray[np.uint8]) -> None:
            start = piece * BATCH
            batch = Batch(start, min(BATCH, depths - start), self.room.target_stride, self._large)
            to_image(modes, batch, plane, image, pitch, space, flag)

        def scratch() -> Workspace:
            line = max(t.image_modes)
            return self._workspace(0, (line, line, line, line), plane.shown_x * (t.image_modes[1] | 1), plane)

        self._run("image", -(-depths // BATCH), scratch, work, watch)
        if pitch > depths:
            compact_rows(image, lines, pitch, depths)
        return image[: lines * depths].reshape(shape)

    def lateral_adjoint(
        self, modes: RealArray, watch: ProgressMonitor = NO_MONITOR, *, kept: bool = False
    ) -> RealArray:
        """Return the traces of lateral modes (NUFFT type 2)."""
        from steradian.imaging.engines.numba.type2 import type2

        s, samples = self._sensors, self.tables.time.samples
        plane = self._plane(self.tables.lateral.grid)
        traces = self._empty(len(s.scale) * samples).reshape(-1, samples)

        def work(piece: int, space: Workspace, flag: NDArray[np.uint8]) -> None:
            start = piece * BATCH
            batch = Batch(start, min(BATCH, samples - start), self.room.source_stride, self._large)
            type2(modes, batch, plane, s, traces, space, flag)

        def scratch() -> Workspace:
            line = max(plane.x.size, plane.y.size + s.wy.shape[1])
            middle = 2 * len(self._stored.ys) * (plane.x.size | 1)
            return self._workspace(len(s.order), (line, line, line, line), middle, plane)

        self._run("sensors", -(-samples // BATCH), scratch, work, watch)
        return traces

    def to_depth_adjoint(self, modes: RealArray, watch: ProgressMonitor = NO_MONITOR) -> RealArray:
        """Return the modes over time of modes over depth; only for transposable tables."""
        from steradian.imaging.engines.numba.depth import to_time

        self._require_transposable()
        self._columns("depth to time", to_time, modes, modes, watch)
        return modes

    def to_image_adjoint(self, image: RealArray, watch: ProgressMonitor = NO_MONITOR) -> RealArray:
        """Return the modes over depth of an image; only for transposable tables, not upsampled."""
        self._require_transposable()
        modes = self._empty(self.room.source_size)
        columns = image.reshape(-1, self.tables.depths)
        plane, stored = self._plane(self.tables.lateral.modes), all_stored(self.tables.lateral.modes)
        self._type1(
            "lateral transform", columns, image_points_as_sensors(self.tables), plane, stored, modes, watch, add=False
        )
        return modes

    def with_sensors(self, lateral: LateralTransform) -> Self:
        """Return an engine with other sensors, on the same lateral grid, which shares the other tables."""
        other, sensors = copy(self), sensors_of(lateral, self.tables.dtype)
        vars(other).update(tables=replace(self.tables, lateral=lateral), _sensors=sensors)
        return other

    def _require_transposable(self) -> None:
        if not self.tables.transposable:
            raise NotImplementedError("these tables have no transpose")

    def _type1(
        self, stage: str, traces: NDArray[Any], sensors: Sensors, plane: ImagePlane, stored: StoredModes,
        target: RealArray, watch: ProgressMonitor, *, add: bool,
    ) -> None:  # fmt: skip
        from steradian.imaging.engines.numba.type1 import pack, type1

        single = self.tables.dtype == "float32"
        integer, mask, most = (np.int32, 0xFF << 23, 127) if single else (np.int64, 0x7FF << 52, 1023)
        most = (most + MAX_EXPONENT[self.tables.dtype]) << (23 if single else 52)  # as bits of the exponent
        flat, samples = np.ascontiguousarray(traces).reshape(-1), traces.shape[1]

        def work(piece: int, space: Workspace, flag: NDArray[np.uint8]) -> None:
            start = piece * BATCH
            batch = Batch(start, min(BATCH, samples - start), self.room.source_stride, self._large)
            if not pack(flat, samples, sensors, batch, space.packed, space.packed.view(integer), mask, most):
                raise InvalidInput("traces", describe_non_finite(traces), "finite numbers")
            type1(sensors, plane, stored, target, batch, add, space, flag)

        def scratch() -> Workspace:
            line = max(plane.x.size, plane.y.size + sensors.wy.shape[1])
            return self._workspace(len(sensors.order), (line, line), 2 * len(stored.ys) * (plane.x.size | 1), plane)

        self._run(stage, -(-samples // BATCH), scratch, work, watch)

    def _columns(
        self, stage: str, kernel: Any, over_time: RealArray, over_depth: RealArray, watch: ProgressMonitor
    ) -> None:
        t, table, room, g = self.tables, self._blocks, self.room, self.tables.geometry
        over_time[room.source_rows * room.source_stride :] = 0  # the spare row

        def side(values: RealArray, rows: NDArray[np.int64], spare: int, stride: int, *more: Any) -> AxisTransform:
            real = np.where(rows < 0, spare, rows) * stride
            return AxisTransform(values, real, np.where(rows < 0, spare, rows + 1) * stride, *more)

        none = _NONE.astype(t.dtype)
        forward, back = transform(t.time.length, t.dtype), transform(g.depth_points, t.dtype)
        divided = t.time.divided.astype(t.dtype)
        times = side(
            over_time, table.source, room.source_rows, room.source_stride, t.time.samples, t.time.centre, divided,
            table.factors, forward.kernel_args,
        )  # fmt: skip
        depths = side(
            over_depth, table.target, room.target_rows, room.target_stride, t.depths, -g.depth[0], none,
            none.reshape(0, 1), back.kernel_args,
        )  # fmt: skip
        rule, scratch = kappa_map(t, table), self._column_space(max(forward.scratch, back.scratch, 16))
        count = len(table.source)
        each = min(_BLOCKS, -(-count // 16))

        def work(piece: int, space: DepthWorkspace, flag: NDArray[np.uint8]) -> None:
            kernel(piece * each, min((piece + 1) * each, count), times, depths, rule, space, flag)

        self._run(stage, -(-count // each), scratch, work, watch)

    def _column_space(self, tmp: int) -> Callable[[], DepthWorkspace]:
        dtype, time = self.tables.dtype, self.tables.time
        cells = 32 * (max(time.length, self.tables.geometry.depth_points) + 2 * CELL_PADDING)
        sizes = (DEPTH_CHUNK, DEPTH_CHUNK, DEPTH_CHUNK, DEPTH_CHUNK * len(time.taps), tmp * 32)

        def scratch() -> DepthWorkspace:
            a, b = aligned_empty(cells, dtype), aligned_empty(cells, dtype)
            return DepthWorkspace(
                a, b, np.zeros(DEPTH_CHUNK, np.int32), *(aligned_empty(size, dtype) for size in sizes)
            )

        return scratch

    def _plane(self, grid: tuple[int, int]) -> ImagePlane:
        (x, nx), (y, ny) = self.tables.visible_region
        tables = [transform(n, self.tables.dtype).kernel_args for n in grid]
        return ImagePlane(*self.tables.lateral.modes, tables[0], tables[1], x, nx, y, ny)

    def _workspace(self, packed: int, lines: tuple[int, ...], middle: int, plane: ImagePlane) -> Workspace:
        tables: list[FftTables] = [transform(f.size, self.tables.dtype) for f in (plane.x, plane.y)]
        tmp = max(*(table.scratch for table in tables), 1)
        sizes = (packed, *lines, *(0 for _ in range(4 - len(lines))), middle, tmp)
        return Workspace(*(aligned_empty(size * 32, self.tables.dtype) for size in sizes))

    def _empty(self, count: int) -> RealArray:
        """Allocate an array whose memory pages are first touched by the threads in parallel.

        A step's batches reach all over it: its first ones would all wait for the same pages.
        """
        numbers = aligned_empty(count, self.tables.dtype)
        if self._threads > 1:
            each = PREFAULT_BYTES // numbers.itemsize

            def touch(piece: int, space: None, flag: NDArray[np.uint8]) -> None:
                numbers[piece * each : (piece + 1) * each : PAGE_BYTES // numbers.itemsize] = 0

            workers.parallel_for(
                "", -(-count // each), lambda: None, touch, threads=self._threads, **NO_MONITOR._asdict()
            )
        return numbers

    def _run(
        self, stage: str, pieces: int, scratch: Callable[[], Any], work: WorkFunction, watch: ProgressMonitor
    ) -> None:
        workers.parallel_for(stage, pieces, scratch, work, threads=self._threads, **watch._asdict())


if TYPE_CHECKING:

    def _is_an_engine(engine: NumbaEngine) -> Engine:
        return engine
