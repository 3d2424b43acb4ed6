"""Lateral modes to sensor traces, one batch of 32 time samples at a time (compiled).

The transpose of :mod:`steradian.imaging.forward`: inverse transforms onto the oversampled grid, line by line, and an
interpolation at the sensors (paper, NED-NUFFT, equation 6, read from right to left). Again two vectors of 16 samples
are one complex grid.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from steradian.compiled import compiled
from steradian.imaging.fft import fft
from steradian.imaging.simd import load16, splat16, store


@compiled
def _join(source: Any, at: int, stride: int, count: int, p: Any, po: int, q: Any, qo: int) -> None:
    """C = Â + iB̂ at one mode into p and at the opposite mode into q."""
    if count < 32:
        for n in range(32):
            p[po + n] = source[at + n] if n < count else 0
            q[qo + n] = source[at + stride + n] if n < count else 0
        ar, br, ai, bi = load16(p, po), load16(p, po + 16), load16(q, qo), load16(q, qo + 16)
    else:
        ar, br = load16(source, at), load16(source, at + 16)
        ai, bi = load16(source, at + stride), load16(source, at + stride + 16)
    store(p, po, ar - bi)
    store(p, po + 16, ai + br)
    store(q, qo, ar + bi)
    store(q, qo + 16, br - ai)


@compiled
def _interpolate_row(
    row: Any, ro: int, line: int, packed: Any, starts: Any, first: Any, wx: Any, wy: Any, nx: int, ny: int
) -> None:
    """Add what grid line ``line`` gives to the sensors whose stencil meets it; wy has an even number of taps."""
    ax, ay = wx.shape[1], wy.shape[1]
    for t in range(ax):
        bin_ = (line - t + nx) % nx
        for m in range(starts[bin_], starts[bin_ + 1]):
            i = ro + first[m] * 32
            a, b = splat16(row.dtype.type(0.0)), splat16(row.dtype.type(0.0))
            for u in range(ay):
                w = splat16(wy[m, u])
                a = a + w * load16(row, i)
                b = b + w * load16(row, i + 16)
                i += 32
            w = splat16(wx[m, t])
            store(packed, m * 32, load16(packed, m * 32) + a * w)
            store(packed, m * 32 + 16, load16(packed, m * 32 + 16) + b * w)


@compiled
def _pick_row(row: Any, ro: int, line: int, packed: Any, starts: Any, cells: Any, sensors: Any, weights: Any) -> None:
    """Add the (cell, sensor, weight) entries of grid line ``line``."""
    for e in range(starts[line], starts[line + 1]):
        w, i, m = splat16(weights[e]), ro + cells[e] * 32, sensors[e] * 32
        store(packed, m, load16(packed, m) + load16(row, i) * w)
        store(packed, m + 16, load16(packed, m + 16) + load16(row, i + 16) * w)


@compiled
def sense(
    source: Any, stride: int, start: int, count: int, modes_x: int, modes_y: int,
    separable: bool, starts: Any, first: Any, sensors: Any, wx: Any, wy: Any, nx: int, ny: int,
    order: Any, scale: Any, fx: Any, fy: Any, flag: Any,
    packed: Any, a: Any, b: Any, c: Any, d: Any, middle: Any, tmp: Any, traces: Any, samples: int,
) -> None:  # fmt: skip
    """Write samples ``start`` … of this batch at every sensor; ``traces`` is flat, a row has ``samples``.

    ``source`` holds the modes as :func:`steradian.imaging.forward.forward` leaves them. Modes at N/2 count as 0.
    """
    half = modes_y // 2 + 1 - (1 if modes_y % 2 == 0 else 0)  # without N/2
    zero, one = np.int64(0), np.int64(1)
    stored = modes_y // 2 + 1
    for o in range(packed.size):
        packed[o] = 0
    for k in range(half):
        if flag[0]:
            return
        a[: nx * 32] = 0
        c[: nx * 32] = 0
        for i in range(modes_x):
            if 2 * i == modes_x and modes_x > 1:
                continue
            j = i if 2 * i < modes_x else nx - modes_x + i
            o = 0 if i == 0 else modes_x - i
            o = o if 2 * o < modes_x else nx - modes_x + o
            _join(source, 2 * (i * stored + k) * stride + start, stride, count, a, j * 32, c, o * 32)
        p = b if nx > 1 and fft(a, zero, b, zero, one, nx, fx[0], fx[1], fx[2], fx[3], fx[4], tmp) == 1 else a
        o = 2 * k * nx * 32
        for x in range(nx * 2):
            store(middle, o + x * 16, load16(p, x * 16))
        if k > 0:
            q = d if nx > 1 and fft(c, zero, d, zero, one, nx, fx[0], fx[1], fx[2], fx[3], fx[4], tmp) == 1 else c
            o = (2 * k + 1) * nx * 32
            for x in range(nx * 2):
                store(middle, o + x * 16, load16(q, x * 16))
    for line in range(nx):
        if flag[0]:
            return
        hit = not separable and starts[line] < starts[line + 1]
        if separable:
            for t in range(wx.shape[1]):
                bin_ = (line - t + nx) % nx
                hit = hit or starts[bin_] < starts[bin_ + 1]
        if not hit:
            continue
        a[: ny * 32] = 0
        for k in range(half):
            i, o = (2 * k * nx + line) * 32, k * 32
            store(a, o, load16(middle, i))
            store(a, o + 16, load16(middle, i + 16))
            if k > 0:
                i, o = ((2 * k + 1) * nx + line) * 32, (ny - k) * 32
                store(a, o, load16(middle, i))
                store(a, o + 16, load16(middle, i + 16))
        row = b if fft(a, zero, b, zero, one, ny, fy[0], fy[1], fy[2], fy[3], fy[4], tmp) else a
        if separable:
            for o in range(0, wy.shape[1] * 32, 16):
                store(row, ny * 32 + o, load16(row, o))
            _interpolate_row(row, zero, line, packed, starts, first, wx, wy, nx, ny)
        else:
            _pick_row(row, zero, line, packed, starts, first, sensors, wy[:, 0])
    for m in range(order.size):
        o, i, factor = order[m] * samples + start, m * 32, scale[m]
        for n in range(count):
            traces[o + n] = packed[i + n] * factor
