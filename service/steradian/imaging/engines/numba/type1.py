"""Compiled NUFFT type 1: sensor traces to lateral modes, 32 samples at a time.

The batch is two vectors of 16 samples, taken as real and imaginary part of one complex lateral grid; the transforms of
the two are separated by symmetry afterwards. So the grid [x][y][cell] is real data in both parts, every spread is an
addition of two vectors, and each transform is on whole cells (paper, NED-NUFFT, equation 6).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from steradian.core.jit import jit, jit_inline
from steradian.imaging.engines.numba.fft import fft
from steradian.imaging.engines.numba.kernel_args import Batch, ImagePlane, Sensors, StoredModes, Workspace
from steradian.imaging.engines.numba.real_pairs import CellIndex, split_real_pair
from steradian.imaging.engines.numba.simd import broadcast16, load16, store, store_fence


@partial(jit, fast=False)
def pack(
    traces: Any, samples: int, sensors: Sensors, batch: Batch, packed: Any, bits: Any, mask: int, most: int
) -> bool:
    """Copy up to 32 scaled samples of each trace in the sensors' order; False if one is too large or not finite.

    ``traces`` is flat, ``samples`` a row; ``bits`` is ``packed`` seen as integers, ``mask`` the exponent's bits, which
    are all set in numbers that are not finite, and ``most`` the exponent that is too large for sums of many.
    """
    order, scale, start, count = sensors.order, sensors.scale, batch.start, batch.number
    for i in range(order.size):
        # unsigned: Numba then has no negative index to look for, and the loop is vectorised
        a, b, factor = np.uint64(order[i] * samples + start), np.uint64(i * 32), scale[i]
        if count == 32:
            for n in range(np.uint64(32)):
                packed[b + n] = traces[a + n] * factor
        else:
            for n in range(np.uint64(32)):
                packed[b + n] = traces[a + n] * factor if n < count else 0
    mask = bits.dtype.type(mask)
    largest = bits.dtype.type(0)
    for i in range(np.uint64(order.size * 32)):
        largest = max(largest, bits[i] & mask)
    return bool(largest < most)


@jit_inline
def _spread_row(row: Any, line: int, packed: Any, sensors: Sensors, nx: int, ny: int) -> bool:
    """Add the sensors with grid line ``line`` in their stencil to that line; False if there is none."""
    starts, first, wx, wy = sensors.starts, sensors.first, sensors.wx, sensors.wy
    ax, ay = wx.shape[1], wy.shape[1]
    hit = False
    for t in range(ax):
        bin_ = (line - t + nx) % nx
        for m in range(starts[bin_], starts[bin_ + 1]):
            if not hit:
                row[: (ny + ay) * 32] = 0
                hit = True
            w = broadcast16(wx[m, t])
            a, b = load16(packed, m * 32) * w, load16(packed, m * 32 + 16) * w
            i = first[m] * 32
            for u in range(0, ay, 2):
                v, w = broadcast16(wy[m, u]), broadcast16(wy[m, u + 1])
                p, q, r, s = load16(row, i), load16(row, i + 16), load16(row, i + 32), load16(row, i + 48)
                store(row, i, p + a * v)
                store(row, i + 16, q + b * v)
                store(row, i + 32, r + a * w)
                store(row, i + 48, s + b * w)
                i += 64
    if hit:
        for i in range(0, ay * 32, 16):
            store(row, i, load16(row, i) + load16(row, ny * 32 + i))
    return hit


@jit_inline
def _add_on_grid_row(row: Any, line: int, packed: Any, sensors: Sensors, ny: int) -> bool:
    """Add the (cell, sensor, weight) entries of grid line ``line``; False if there is none."""
    cells, senders, weights = sensors.first, sensors.sensors, sensors.wy
    first, last = sensors.starts[line], sensors.starts[line + 1]
    if first == last:
        return False
    row[: ny * 32] = 0
    for e in range(first, last):
        w, i, m = broadcast16(weights[e, 0]), cells[e] * 32, senders[e] * 32
        store(row, i, load16(row, i) + load16(packed, m) * w)
        store(row, i + 16, load16(row, i + 16) + load16(packed, m + 16) * w)
    return True


@jit
def type1(
    sensors: Sensors,
    plane: ImagePlane,
    stored: StoredModes,
    target: Any,
    batch: Batch,
    add: bool,
    space: Workspace,
    flag: Any,
) -> None:
    """Spread traces to the grid, FFT along y and x, and store or accumulate the modes' samples of this batch."""
    row, work, middle, tmp = space.a, space.b, space.middle, space.tmp
    nx, ny = plane.x.size, plane.y.size
    pitch = nx | 1  # lines that are a multiple of a page apart would share a few places of the caches
    xs, xs_opposite, ys, ys_opposite = stored.xs, stored.xs_opposite, stored.ys, stored.ys_opposite
    edge_rows, edge_xs, edge_xs_opposite = stored.edge_rows, stored.edge_xs, stored.edge_xs_opposite
    half = ys.size
    zero = np.int64(0)
    done = row
    for line in range(nx):
        done = row
        if flag[0]:
            return
        if sensors.separable:
            hit = _spread_row(row, line, space.packed, sensors, nx, ny)
        else:
            hit = _add_on_grid_row(row, line, space.packed, sensors, ny)
        if not hit and nx > 1:
            for k in range(2 * half):
                o = (k * pitch + line) * 32
                middle[o : o + 32] = 0
            continue
        if not hit:
            row[: ny * 32] = 0
        if fft(row, zero, work, zero, zero, plane.y, tmp):
            done = work
        if nx == 1:
            break
        for k in range(half):
            o, i = (2 * k * pitch + line) * 32, ys[k] * 32
            store(middle, o, load16(done, i))
            store(middle, o + 16, load16(done, i + 16))
            if ys_opposite[k] != ys[k]:
                o, i = ((2 * k + 1) * pitch + line) * 32, ys_opposite[k] * 32
                store(middle, o, load16(done, i))
                store(middle, o + 16, load16(done, i + 16))
    for k in range(half):
        if flag[0]:
            return
        p, po = done, ys[k] * 32
        q, qo = done, ys_opposite[k] * 32
        if nx > 1:
            po = 2 * k * pitch * 32
            odd = plane.x.radices.size % 2  # then the result is in the other buffer
            p = work if fft(middle, po, work, zero, zero, plane.x, tmp) else middle
            po = 0 if odd else po
            q, qo = p, po
            if ys_opposite[k] != ys[k]:
                qo = (2 * k + 1) * pitch * 32
                q = row if fft(middle, qo, row, zero, zero, plane.x, tmp) else middle
                qo = 0 if odd else qo
        at = 2 * k * xs.size * batch.stride + batch.start
        split_real_pair(CellIndex(p, po, xs), CellIndex(q, qo, xs_opposite), target, batch, at, add)
        for i in range(xs.size):
            if edge_rows[i, k] >= 0:
                at = edge_rows[i, k] * batch.stride + batch.start
                a, b = edge_xs[i : i + 1], edge_xs_opposite[i : i + 1]
                if stored.edge_swap[k]:
                    split_real_pair(CellIndex(q, qo, a), CellIndex(p, po, b), target, batch, at, add)
                else:
                    split_real_pair(CellIndex(p, po, a), CellIndex(q, qo, b), target, batch, at, add)
    store_fence()
