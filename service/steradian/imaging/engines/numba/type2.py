"""Compiled NUFFT type 2: lateral modes to sensor traces, 32 time samples at a time.

The transpose of :mod:`.type1`: inverse transforms onto the oversampled grid, line by line, and an interpolation at the
sensors (paper, NED-NUFFT, equation 6, read from right to left). Again two vectors of 16 samples are one complex grid.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from steradian.core.jit import jit, jit_inline
from steradian.imaging.engines.numba.fft import fft
from steradian.imaging.engines.numba.kernel_args import Batch, ImagePlane, Sensors, Workspace
from steradian.imaging.engines.numba.real_pairs import merge_real_pair
from steradian.imaging.engines.numba.simd import broadcast16, load16, store


@jit_inline
def _interpolate_row(row: Any, line: int, packed: Any, sensors: Sensors, nx: int) -> None:
    """Add the contribution of grid line ``line`` to the sensors with this line in their stencil."""
    starts, first, wx, wy = sensors.starts, sensors.first, sensors.wx, sensors.wy
    ax, ay = wx.shape[1], wy.shape[1]
    for t in range(ax):
        bin_ = (line - t + nx) % nx
        for m in range(starts[bin_], starts[bin_ + 1]):
            i = first[m] * 32
            a, b = broadcast16(row.dtype.type(0.0)), broadcast16(row.dtype.type(0.0))
            for u in range(ay):
                w = broadcast16(wy[m, u])
                a = a + w * load16(row, i)
                b = b + w * load16(row, i + 16)
                i += 32
            w = broadcast16(wx[m, t])
            store(packed, m * 32, load16(packed, m * 32) + a * w)
            store(packed, m * 32 + 16, load16(packed, m * 32 + 16) + b * w)


@jit_inline
def _read_on_grid_row(row: Any, line: int, packed: Any, sensors: Sensors) -> None:
    """Add the (cell, sensor, weight) entries of grid line ``line``."""
    cells, receivers, weights = sensors.first, sensors.sensors, sensors.wy
    for e in range(sensors.starts[line], sensors.starts[line + 1]):
        w, i, m = broadcast16(weights[e, 0]), cells[e] * 32, receivers[e] * 32
        store(packed, m, load16(packed, m) + load16(row, i) * w)
        store(packed, m + 16, load16(packed, m + 16) + load16(row, i + 16) * w)


@jit
def type2(
    source: Any, batch: Batch, plane: ImagePlane, sensors: Sensors, traces: Any, space: Workspace, flag: Any
) -> None:
    """Compute a batch of samples of every sensor from the modes, into ``traces`` (M, N_t); modes at N/2 count as 0."""
    packed, a, b, c, d, middle, tmp = space
    nx, ny, modes_x = plane.x.size, plane.y.size, plane.modes_x
    half, pitch = (plane.modes_y + 1) // 2, nx | 1  # without N/2; see type1
    zero, one = np.int64(0), np.int64(1)
    for o in range(packed.size):
        packed[o] = 0
    for k in range(half):
        if flag[0]:
            return
        merge_real_pair(source, 2 * k * modes_x * batch.stride + batch.start, batch, modes_x, a, c, nx, False)
        p = b if nx > 1 and fft(a, zero, b, zero, one, plane.x, tmp) == 1 else a
        o = 2 * k * pitch * 32
        for x in range(nx * 2):
            store(middle, o + x * 16, load16(p, x * 16))
        if k > 0:
            q = d if nx > 1 and fft(c, zero, d, zero, one, plane.x, tmp) == 1 else c
            o = (2 * k + 1) * pitch * 32
            for x in range(nx * 2):
                store(middle, o + x * 16, load16(q, x * 16))
    starts, wx, wy = sensors.starts, sensors.wx, sensors.wy
    for line in range(nx):
        if flag[0]:
            return
        hit = not sensors.separable and starts[line] < starts[line + 1]
        if sensors.separable:
            for t in range(wx.shape[1]):
                bin_ = (line - t + nx) % nx
                hit = hit or starts[bin_] < starts[bin_ + 1]
        if not hit:
            continue
        a[: ny * 32] = 0
        for k in range(half):
            i, o = (2 * k * pitch + line) * 32, k * 32
            store(a, o, load16(middle, i))
            store(a, o + 16, load16(middle, i + 16))
            if k > 0:
                i, o = ((2 * k + 1) * pitch + line) * 32, (ny - k) * 32
                store(a, o, load16(middle, i))
                store(a, o + 16, load16(middle, i + 16))
        row = b if fft(a, zero, b, zero, one, plane.y, tmp) else a
        if sensors.separable:
            for o in range(0, wy.shape[1] * 32, 16):
                store(row, ny * 32 + o, load16(row, o))
            _interpolate_row(row, line, packed, sensors, nx)
        else:
            _read_on_grid_row(row, line, packed, sensors)
    order, scale, start = sensors.order, sensors.scale, batch.start
    for m in range(order.size):
        for n in range(batch.number):
            traces[order[m], start + n] = packed[m * 32 + n] * scale[m]
