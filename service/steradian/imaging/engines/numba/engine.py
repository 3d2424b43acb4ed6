"""The engine that reconstructions use: its memory, and the six steps in pieces on threads."""

from __future__ import annotations

from collections.abc import Callable
from math import factorial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.compute import memory_limit as memory
from steradian.imaging.compute import thread_pool as workers
from steradian.imaging.engines import NOBODY, Watch
from steradian.imaging.engines.numba.arguments import Batch, Columns, Plane, Rule, Sensors, Side, Stored, Workspace
from steradian.imaging.engines.numba.blocks import Blocks, blocks
from steradian.imaging.engines.numba.factors import Transform, transform
from steradian.imaging.engines.numba.layout import all_stored, everywhere, part, sensors_of, stored_of
from steradian.imaging.engines.numba.room import Room, empty, room_of, whole
from steradian.imaging.engines.numba.sizes import BATCH, PAD, PIECE
from steradian.imaging.tables import Tables
from steradian.imaging.validation import SUMMABLE, first_bad
from steradian.imaging.volume import RealArray

if TYPE_CHECKING:
    from steradian.imaging.engines import Engine

_BLOCKS = 32  # most blocks of columns a piece of work has
_SMALL = 1 << 21  # numbers that the caches hold, and for which waiting for a second thread costs more than it saves
_PAGE, _TOUCHED = 1 << 12, 1 << 24  # bytes of a page, at least, and of what a thread brings in at a time
_NONE = np.empty(0)
Work = Callable[[int, Any, NDArray[np.uint8]], None]


class NumbaEngine:
    """An :class:`~steradian.imaging.engines.Engine` of compiled kernels. Modes are rows of one flat array.

    Parameters
    ----------
    tables
        What to compute.
    threads
        At most.
    memory_limit
        See :func:`steradian.imaging.compute.memory_limit.require`.

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

    def __init__(self, tables: Tables, *, threads: int, memory_limit: int | None = None) -> None:
        self.tables = tables
        self._stored = stored_of(tables.lateral, edges=tables.rule.waves == "rising")
        self.room: Room = room_of(tables, self._stored, threads)
        memory.require(self.room.memory_bytes, memory_limit, tables.geometry.shape)
        self._sensors = sensors_of(tables.lateral, tables.dtype)
        self._blocks: Blocks = blocks(tables, self._stored)
        numbers = max(self.room.target_rows * tables.depths, self.room.output_bytes // np.dtype(tables.dtype).itemsize)
        self._large = numbers >= _SMALL
        self._threads = self.room.threads if self._large else 1

    def lateral(
        self,
        traces: Any,
        watch: Watch = NOBODY,
        *,
        scale: float = 1.0,
        sensors: NDArray[Any] | None = None,
        onto: Any = None,
    ) -> RealArray:
        """See :class:`steradian.imaging.engines.Engine`; traces of float32, float64, int16 or int32."""
        target = self._empty(self.room.source_size) if onto is None else onto
        chosen = self._sensors if sensors is None else part(self._sensors, sensors)
        with np.errstate(over="ignore"):  # such traces are refused
            chosen = chosen._replace(scale=(chosen.scale * scale).astype(self.tables.dtype))
        plane = self._plane(self.tables.lateral.grid)
        self._type1("lateral transform", traces, chosen, plane, self._stored, target, watch, add=onto is not None)
        return target

    def to_depth(self, modes: RealArray, watch: Watch = NOBODY, *, kept: bool = False) -> RealArray:
        """See :class:`steradian.imaging.engines.Engine`."""
        from steradian.imaging.engines.numba.depth import to_depth

        target = modes
        if kept or self.tables.lateral.replicated:
            target = self._empty(self.room.target_size)
        self._columns("time to depth", to_depth, modes, target, watch)
        return target

    def to_image(self, modes: RealArray, watch: Watch = NOBODY) -> RealArray:
        """See :class:`steradian.imaging.engines.Engine`."""
        from steradian.imaging.engines.numba.image import close_up, to_image

        t, shape, depths = self.tables, self.tables.geometry.shape, self.tables.depths
        lines, pitch = int(np.prod(shape[:-1])), whole(depths)
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
            close_up(image, lines, pitch, depths)
        return image[: lines * depths].reshape(shape)

    def lateral_adjoint(self, modes: RealArray, watch: Watch = NOBODY) -> RealArray:
        """See :class:`steradian.imaging.engines.Engine`."""
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

    def to_depth_adjoint(self, modes: RealArray, watch: Watch = NOBODY) -> RealArray:
        """See :class:`steradian.imaging.engines.Engine`; of the model's tables only."""
        from steradian.imaging.engines.numba.depth import to_time

        self._model()
        self._columns("depth to time", to_time, modes, modes, watch)
        return modes

    def to_image_adjoint(self, image: RealArray, watch: Watch = NOBODY) -> RealArray:
        """See :class:`steradian.imaging.engines.Engine`; of the model's tables only, upsampled images neither."""
        self._model()
        modes = self._empty(self.room.source_size)
        columns = image.reshape(-1, self.tables.depths)
        plane, stored = self._plane(self.tables.lateral.modes), all_stored(self.tables.lateral.modes)
        self._type1("lateral transform", columns, everywhere(self.tables), plane, stored, modes, watch, add=False)
        return modes

    def _model(self) -> None:
        if self.tables.rule.waves != "both":
            raise NotImplementedError("the transposes are those of the model")

    def _type1(
        self, stage: str, traces: NDArray[Any], sensors: Sensors, plane: Plane, stored: Stored, target: RealArray,
        watch: Watch, *, add: bool,
    ) -> None:  # fmt: skip
        from steradian.imaging.engines.numba.type1 import pack, type1

        single = self.tables.dtype == "float32"
        integer, mask, most = (np.int32, 0xFF << 23, 127) if single else (np.int64, 0x7FF << 52, 1023)
        most = (most + SUMMABLE[self.tables.dtype]) << (23 if single else 52)  # as bits of the exponent
        flat, samples = np.ascontiguousarray(traces).reshape(-1), traces.shape[1]

        def work(piece: int, space: Workspace, flag: NDArray[np.uint8]) -> None:
            start = piece * BATCH
            batch = Batch(start, min(BATCH, samples - start), self.room.source_stride, self._large)
            if not pack(flat, samples, sensors, batch, space.packed, space.packed.view(integer), mask, most):
                raise InvalidInput("traces", first_bad(traces), "finite numbers")
            type1(sensors, plane, stored, target, batch, add, space, flag)

        def scratch() -> Workspace:
            line = max(plane.x.size, plane.y.size + sensors.wy.shape[1])
            return self._workspace(len(sensors.order), (line, line), 2 * len(stored.ys) * (plane.x.size | 1), plane)

        self._run(stage, -(-samples // BATCH), scratch, work, watch)

    def _columns(self, stage: str, kernel: Any, over_time: RealArray, over_depth: RealArray, watch: Watch) -> None:
        t, table, room, g = self.tables, self._blocks, self.room, self.tables.geometry
        over_time[room.source_rows * room.source_stride :] = 0  # the spare row

        def side(values: RealArray, rows: NDArray[np.int64], spare: int, stride: int, *more: Any) -> Side:
            real = np.where(rows < 0, spare, rows) * stride
            return Side(values, real, np.where(rows < 0, spare, rows + 1) * stride, *more)

        none = _NONE.astype(t.dtype)
        forward, back = transform(t.time.length, t.dtype), transform(g.depth_points, t.dtype)
        divided = t.time.divided.astype(t.dtype)
        times = side(
            over_time, table.source, room.source_rows, room.source_stride, t.time.samples, t.time.centre, divided,
            table.factors, forward.factors,
        )  # fmt: skip
        depths = side(
            over_depth, table.target, room.target_rows, room.target_stride, t.depths, -g.depth[0], none,
            none.reshape(0, 1), back.factors,
        )  # fmt: skip
        rule, scratch = self._rule(), self._column_space(max(forward.scratch, back.scratch, 16))
        count = len(table.source)
        each = min(_BLOCKS, -(-count // 16))

        def work(piece: int, space: Columns, flag: NDArray[np.uint8]) -> None:
            kernel(piece * each, min((piece + 1) * each, count), times, depths, rule, space, flag)

        self._run(stage, -(-count // each), scratch, work, watch)

    def _rule(self) -> Rule:
        t, rule = self.tables, self.tables.rule
        terms = range(6 if t.dtype == "float32" else 11)
        sine = np.array([(-1) ** i / factorial(2 * i + 1) for i in terms], t.dtype)
        cosine = np.array([(-1) ** i / factorial(2 * i) for i in terms], t.dtype)
        return Rule(
            self._blocks.squares, self._blocks.edges, t.time.length / t.time.record, rule.turns, rule.band,
            rule.waves == "both", t.time.nearest, t.time.taps.astype(t.dtype), rule.table, rule.steps, sine, cosine,
        )  # fmt: skip

    def _column_space(self, tmp: int) -> Callable[[], Columns]:
        dtype, time = self.tables.dtype, self.tables.time
        cells = 32 * (max(time.length, self.tables.geometry.depth_points) + 2 * PAD)
        sizes = (PIECE, PIECE, PIECE, PIECE * len(time.taps), tmp * 32)

        def scratch() -> Columns:
            a, b = empty(cells, dtype), empty(cells, dtype)
            return Columns(a, b, np.zeros(PIECE, np.int32), *(empty(size, dtype) for size in sizes))

        return scratch

    def _plane(self, grid: tuple[int, int]) -> Plane:
        (x, nx), (y, ny) = self.tables.shown
        tables = [transform(n, self.tables.dtype).factors for n in grid]
        return Plane(*self.tables.lateral.modes, tables[0], tables[1], x, nx, y, ny)

    def _workspace(self, packed: int, lines: tuple[int, ...], middle: int, plane: Plane) -> Workspace:
        tables: list[Transform] = [transform(f.size, self.tables.dtype) for f in (plane.x, plane.y)]
        tmp = max(*(table.scratch for table in tables), 1)
        sizes = (packed, *lines, *(0 for _ in range(4 - len(lines))), middle, tmp)
        return Workspace(*(empty(size * 32, self.tables.dtype) for size in sizes))

    def _empty(self, count: int) -> RealArray:
        """Make room whose pages are there already, brought in by each thread for itself.

        A step's batches reach all over it: its first ones would all wait for the same pages.
        """
        numbers = empty(count, self.tables.dtype)
        if self._threads > 1:
            each = _TOUCHED // numbers.itemsize

            def touch(piece: int, space: None, flag: NDArray[np.uint8]) -> None:
                numbers[piece * each : (piece + 1) * each : _PAGE // numbers.itemsize] = 0

            workers.run("", -(-count // each), lambda: None, touch, threads=self._threads, **NOBODY._asdict())
        return numbers

    def _run(self, stage: str, pieces: int, scratch: Callable[[], Any], work: Work, watch: Watch) -> None:
        workers.run(stage, pieces, scratch, work, threads=self._threads, **watch._asdict())


if TYPE_CHECKING:

    def _is_an_engine(engine: NumbaEngine) -> Engine:
        return engine
