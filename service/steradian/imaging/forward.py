"""Sensor traces to lateral modes, one batch of 32 time samples at a time (compiled).

The batch is two vectors of 16 samples, taken as real and imaginary part of one complex lateral grid; the transforms of
the two are separated by symmetry afterwards. So the grid [x][y][cell] is real data in both parts, every spread is an
addition of two vectors, and each transform is on whole cells (paper, NED-NUFFT, equation 6).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from steradian.compiled import compiled
from steradian.imaging.fft import fft
from steradian.imaging.simd import load16, splat16, store


@partial(compiled, fast=False)
def pack(
    traces: Any, samples: int, order: Any, scale: Any, start: int, count: int, packed: Any, bits: Any, mask: int
) -> bool:
    """Copy ``count`` ≤ 32 samples of each trace, in the given order and scaled; False if one is not finite.

    ``traces`` is flat, ``samples`` a row; ``bits`` is ``packed`` seen as integers and ``mask`` the exponent's bits,
    which are all set in numbers that are not finite.
    """
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
    return bool(largest != mask)


@compiled
def _spread_row(row: Any, line: int, packed: Any, starts: Any, first: Any, wx: Any, wy: Any, nx: int, ny: int) -> bool:
    """Add all sensors whose stencil meets grid line ``line``; False if there is none. wy has an even number of taps."""
    ax, ay = wx.shape[1], wy.shape[1]
    hit = False
    for t in range(ax):
        bin_ = (line - t + nx) % nx
        for m in range(starts[bin_], starts[bin_ + 1]):
            if not hit:
                row[: (ny + ay) * 32] = 0
                hit = True
            w = splat16(wx[m, t])
            a, b = load16(packed, m * 32) * w, load16(packed, m * 32 + 16) * w
            i = first[m] * 32
            for u in range(0, ay, 2):
                v, w = splat16(wy[m, u]), splat16(wy[m, u + 1])
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


@compiled
def _place_row(row: Any, line: int, packed: Any, starts: Any, cells: Any, sensors: Any, weights: Any, ny: int) -> bool:
    """Add the (cell, sensor, weight) entries of grid line ``line``; False if there is none."""
    first, last = starts[line], starts[line + 1]
    if first == last:
        return False
    row[: ny * 32] = 0
    for e in range(first, last):
        w, i, m = splat16(weights[e]), cells[e] * 32, sensors[e] * 32
        store(row, i, load16(row, i) + load16(packed, m) * w)
        store(row, i + 16, load16(row, i + 16) + load16(packed, m + 16) * w)
    return True


@compiled
def _separate(p: Any, po: int, q: Any, qo: int, row: Any, at: int, im_at: int, count: int, add: bool) -> None:
    """Write, or add, Â and B̂ at one mode from C there (p) and at the opposite mode (q); the factor 2 is left in."""
    ar, ai, br, bi = load16(p, po), load16(p, po + 16), load16(q, qo), load16(q, qo + 16)
    if count == 32:
        if add:
            store(row, at, load16(row, at) + ar + br)
            store(row, at + 16, load16(row, at + 16) + ai + bi)
            store(row, im_at, load16(row, im_at) + ai - bi)
            store(row, im_at + 16, load16(row, im_at + 16) + br - ar)
            return
        store(row, at, ar + br)
        store(row, at + 16, ai + bi)
        store(row, im_at, ai - bi)
        store(row, im_at + 16, br - ar)
    else:
        for n in range(count):
            real = row[at + n] if add else row.dtype.type(0)
            imaginary = row[im_at + n] if add else row.dtype.type(0)
            row[at + n] = real + p[po + n] + q[qo + n]
            if n < 16:
                row[im_at + n] = imaginary + p[po + 16 + n] - q[qo + 16 + n]
            else:
                row[im_at + n] = imaginary + q[qo + n - 16] - p[po + n - 16]


@compiled
def forward(
    packed: Any, separable: bool, starts: Any, first: Any, sensors: Any, wx: Any, wy: Any, nx: int, ny: int,
    xs: Any, xs_opposite: Any, edge_xs: Any, edge_xs_opposite: Any, ys: Any, ys_opposite: Any, edge_rows: Any,
    edge_swap: Any, fx: Any, fy: Any, flag: Any, row: Any, work: Any, middle: Any, tmp: Any,
    target: Any, stride: int, start: int, count: int, add: bool,
) -> None:  # fmt: skip
    """Spread, transform along y and x, and store (or add to what is there) the modes' samples of this batch.

    ``target`` holds for column c = i·len(ys) + k the real parts at row 2c and the imaginary ones at row 2c + 1.
    """
    half = ys.size
    zero = np.int64(0)
    done = row
    for line in range(nx):
        done = row
        if flag[0]:
            return
        if separable:
            hit = _spread_row(row, line, packed, starts, first, wx, wy, nx, ny)
        else:
            hit = _place_row(row, line, packed, starts, first, sensors, wy[:, 0], ny)
        if not hit and nx > 1:
            for k in range(2 * half):
                o = (k * nx + line) * 32
                middle[o : o + 32] = 0
            continue
        if not hit:
            row[: ny * 32] = 0
        if fft(row, zero, work, zero, zero, ny, fy[0], fy[1], fy[2], fy[3], fy[4], tmp):
            done = work
        if nx == 1:
            break
        for k in range(half):
            o, i = (2 * k * nx + line) * 32, ys[k] * 32
            store(middle, o, load16(done, i))
            store(middle, o + 16, load16(done, i + 16))
            if ys_opposite[k] != ys[k]:
                o, i = ((2 * k + 1) * nx + line) * 32, ys_opposite[k] * 32
                store(middle, o, load16(done, i))
                store(middle, o + 16, load16(done, i + 16))
    for k in range(half):
        if flag[0]:
            return
        p, po = done, ys[k] * 32
        q, qo = done, ys_opposite[k] * 32
        if nx > 1:
            po = 2 * k * nx * 32
            p = work if fft(middle, po, work, zero, zero, nx, fx[0], fx[1], fx[2], fx[3], fx[4], tmp) else middle
            po = 0 if fx[0].size % 2 else po
            q, qo = p, po
            if ys_opposite[k] != ys[k]:
                qo = (2 * k + 1) * nx * 32
                q = row if fft(middle, qo, row, zero, zero, nx, fx[0], fx[1], fx[2], fx[3], fx[4], tmp) else middle
                qo = 0 if fx[0].size % 2 else qo
        for i in range(xs.size):
            at = 2 * (i * half + k) * stride + start
            _separate(p, po + xs[i] * 32, q, qo + xs_opposite[i] * 32, target, at, at + stride, count, add)
            if edge_rows[i, k] >= 0:
                at = edge_rows[i, k] * stride + start
                a, b = edge_xs[i] * 32, edge_xs_opposite[i] * 32
                if edge_swap[k]:
                    _separate(q, qo + a, p, po + b, target, at, at + stride, count, add)
                else:
                    _separate(p, po + a, q, qo + b, target, at, at + stride, count, add)
