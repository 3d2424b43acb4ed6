"""One run of a plan: three stages of compiled work on threads, bounded memory."""

from __future__ import annotations

from math import factorial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from steradian.errors import InvalidInput
from steradian.imaging import workers
from steradian.imaging.columns import PAD, PIECE, columns
from steradian.imaging.factors import Transform
from steradian.imaging.forward import forward, pack
from steradian.imaging.inverse import backward
from steradian.progress import IsCancelled, Progress

if TYPE_CHECKING:
    from steradian.imaging.lateral import Spread
    from steradian.imaging.plan import ReconstructionPlan

_BATCH = 32  # samples or depths of a cell
_BLOCKS = 32  # most blocks of columns a piece of work has
_SMALL = 1 << 21  # image points below which waiting for a second thread costs more than it saves


def _tables(t: Transform) -> tuple[Any, ...]:
    return t.radices, t.twiddles, t.twiddle_starts, t.generic, t.generic_starts


def _first_bad(traces: NDArray[Any]) -> str:
    for m, row in enumerate(traces):
        bad = np.flatnonzero(~np.isfinite(row))
        if bad.size:
            return f"{row[bad[0]]} at row {m}, column {bad[0]}"
    return "beyond the range of the working precision"


def execute(
    plan: ReconstructionPlan,
    traces: NDArray[Any],
    scale: float,
    progress: Progress | None,
    cancelled: IsCancelled | None,
) -> NDArray[Any]:
    """Flat image [x][(y][)z] of one set of traces."""
    source = np.empty((plan._source_rows + 1) * plan._source_stride, plan.dtype)
    size = plan._out_rows * plan.geometry.shape[-1]
    threads = 1 if size < _SMALL else plan.threads
    how: dict[str, Any] = {"threads": threads, "progress": progress, "cancelled": cancelled}
    _lateral(plan, traces, scale, source, how)
    target = source
    if plan._lateral.replicated:
        target = np.empty((plan._target_rows + 1) * plan._target_stride, plan.dtype)
    _depths(plan, source, target, how)
    del source
    image = target
    if not plan._shared:
        image = np.empty(size, plan.dtype)
    _images(plan, target, image, how)
    del target
    return image[:size]


def _lateral(
    plan: ReconstructionPlan,
    traces: NDArray[Any],
    scale: float,
    source: NDArray[Any],
    how: dict[str, Any],
    some: Spread | None = None,
) -> None:
    """Lateral modes of the traces; of ``some`` sensors' traces added to what is there, for an image that grows."""
    lateral, spread = plan._lateral, some or plan._lateral.spread
    fx, fy, *_ = plan.transforms()
    nx, ny = lateral.grid
    line = max(nx, ny + spread.wy.shape[1])
    factors = (spread.scale * scale).astype(plan.dtype)
    integer, mask = (np.int32, 0x7F800000) if plan.dtype == "float32" else (np.int64, 0x7FF0000000000000)
    flat = np.ascontiguousarray(traces).reshape(-1)

    def scratch() -> tuple[NDArray[Any], ...]:
        cells = (len(factors), line, line, 2 * len(lateral.ys) * nx, max(fx.scratch, fy.scratch, 1))
        return tuple(np.empty(c * 32, plan.dtype) for c in cells)

    def work(piece: int, space: tuple[NDArray[Any], ...], flag: NDArray[np.uint8]) -> None:
        packed, row, other, middle, tmp = space
        start = piece * _BATCH
        count = min(_BATCH, plan.geometry.samples - start)
        if not pack(
            flat, plan.geometry.samples, spread.order, factors, start, count, packed, packed.view(integer), mask
        ):
            raise InvalidInput("traces", _first_bad(traces), "finite numbers")
        forward(
            packed, spread.separable, spread.starts, spread.first, spread.sensors, spread.wx, spread.wy, nx, ny,
            lateral.xs, lateral.xs_opposite, lateral.edge_xs, lateral.edge_xs_opposite, lateral.ys, lateral.ys_opposite,
            lateral.edge_rows, lateral.edge_swap, _tables(fx), _tables(fy), flag, row, other, middle, tmp,
            source, plan._source_stride, start, count, some is not None,
        )  # fmt: skip

    workers.run("lateral transform", -(-plan.geometry.samples // _BATCH), scratch, work, **how)


def _depths(plan: ReconstructionPlan, source: NDArray[Any], target: NDArray[Any], how: dict[str, Any]) -> None:
    g, table = plan.geometry, plan._blocks
    *_, ft, fz, _, _ = plan.transforms()
    # lanes not in use read and write the spare row at the end
    real = np.where(table.source < 0, plan._source_rows, table.source) * plan._source_stride
    imaginary = np.where(table.source < 0, plan._source_rows, table.source + 1) * plan._source_stride
    out_real = np.where(table.target < 0, plan._target_rows, table.target) * plan._target_stride
    out_imaginary = np.where(table.target < 0, plan._target_rows, table.target + 1) * plan._target_stride
    terms = 6 if plan.dtype == "float32" else 11
    sine = np.array([(-1) ** i / factorial(2 * i + 1) for i in range(terms)], plan.dtype)
    cosine = np.array([(-1) ** i / factorial(2 * i) for i in range(terms)], plan.dtype)
    if plan.dtype == "float32":
        source[plan._source_rows * plan._source_stride :] = 0

    def scratch() -> tuple[NDArray[Any], ...]:
        cells = max(plan._length, g.record) + 2 * PAD
        return (
            np.zeros(cells * 32, plan.dtype),
            np.zeros(cells * 32, plan.dtype),
            np.zeros(PIECE, np.int32),
            np.zeros(PIECE, plan.dtype),
            np.zeros(PIECE, plan.dtype),
            np.zeros(PIECE, plan.dtype),
            np.zeros(PIECE * len(plan._taps), plan.dtype),
            np.zeros(max(ft.scratch, fz.scratch, 16) * 32, plan.dtype),
        )

    each = min(_BLOCKS, -(-len(real) // 16))

    def work(piece: int, space: tuple[NDArray[Any], ...], flag: NDArray[np.uint8]) -> None:
        columns(
            piece * each, min((piece + 1) * each, len(real)), source, real, imaginary, table.factors, table.squares,
            table.edges, target, out_real, out_imaginary, g.samples, plan._centre, plan._length, plan._time_window,
            g.record, plan._length / g.record, plan._turns, *plan._filter, len(plan._taps), plan._nearest, plan._taps,
            sine, cosine, g.depth[0], g.depth[1] - g.depth[0], _tables(ft), _tables(fz), flag, *space,
        )  # fmt: skip

    workers.run("time to depth", -(-len(real) // each), scratch, work, **how)


def _images(plan: ReconstructionPlan, target: NDArray[Any], image: NDArray[Any], how: dict[str, Any]) -> None:
    g = plan.geometry
    *_, fx, fy = plan.transforms()
    nx, ny = plan._inverse_size()
    out = g.shape[:-1] if len(g.modes) == 2 else (1, g.shape[0])
    skipped = [(p // 2 - n // 2) * g.upsampling for p, n in zip(g.padded_modes, g.modes, strict=True)]
    first = skipped if len(g.modes) == 2 else [0, *skipped]
    depth = g.shape[-1]

    def scratch() -> tuple[NDArray[Any], ...]:
        line = max(nx, ny)
        cells = (line, line, line, line, out[0] * ny, max(fx.scratch, fy.scratch, 1))
        return tuple(np.empty(c * 32, plan.dtype) for c in cells)

    def work(piece: int, space: tuple[NDArray[Any], ...], flag: NDArray[np.uint8]) -> None:
        start = piece * _BATCH
        backward(
            target, plan._target_stride, start, min(_BATCH, depth - start), *plan._modes, nx, ny, first[0], out[0],
            first[1], out[1], _tables(fx), _tables(fy), flag, *space, image, depth,
        )  # fmt: skip

    workers.run("image", -(-depth // _BATCH), scratch, work, **how)
