"""Lateral modes to image, one batch of 32 depths at a time (compiled).

Two vectors of 16 depths are one complex lateral grid again, whose inverse transform has the first 16 images as real and
the others as imaginary part. A batch reads its depths of all columns before it writes the same depths of the image, so
both may share one block of memory.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from steradian.core.jit import jit, jit_inline
from steradian.imaging.engines.numba.fft import fft
from steradian.imaging.engines.numba.kernel_args import Batch, ImagePlane, Workspace
from steradian.imaging.engines.numba.real_pairs import merge_real_pair
from steradian.imaging.engines.numba.simd import broadcast16, load16, store, store_fence, stream_store


@jit_inline
def _halve(a: Any, i: int, j: int) -> None:
    """Split the Nyquist cell i between i and j."""
    half = broadcast16(a.dtype.type(0.5))
    for o in (0, 16):
        v = load16(a, i + o) * half
        store(a, i + o, v)
        store(a, j + o, v)


@jit
def to_image(source: Any, batch: Batch, plane: ImagePlane, image: Any, depth: int, space: Workspace, flag: Any) -> None:
    """Compute the visible image points of a batch of depths, by FFT; a finer image grid interpolates.

    ``image`` is flat [x][y][z], its lines ``depth`` values apart, a multiple of 16.
    """
    _, a, b, c, d, middle, tmp = space
    modes_x, modes_y, nx, ny, out_x, out_y = (
        plane.modes_x, plane.modes_y, plane.x.size, plane.y.size, plane.shown_x, plane.shown_y
    )  # fmt: skip
    half, pitch = modes_y // 2 + 1, ny | 1  # see type1
    zero, one = np.int64(0), np.int64(1)
    for k in range(half):
        if flag[0]:
            return
        merge_real_pair(source, 2 * k * modes_x * batch.stride + batch.start, batch, modes_x, a, c, nx, True)
        if nx > modes_x and modes_x % 2 == 0:
            _halve(a, (nx - modes_x // 2) * 32, modes_x // 2 * 32)
            _halve(c, (nx - modes_x // 2) * 32, modes_x // 2 * 32)
        p = b if nx > 1 and fft(a, zero, b, zero, one, plane.x, tmp) == 1 else a
        nyquist = 2 * k == modes_y
        if nyquist and ny > modes_y:
            for x in range(out_x):
                i, o = (plane.first_x + x) * 32, (x * pitch + k) * 32
                store(middle, o, load16(p, i))
                store(middle, o + 16, load16(p, i + 16))
                _halve(middle, o, (x * pitch + ny - k) * 32)
            continue
        for x in range(out_x):
            i, o = (plane.first_x + x) * 32, (x * pitch + k) * 32
            store(middle, o, load16(p, i))
            store(middle, o + 16, load16(p, i + 16))
        if k == 0 or nyquist:
            continue
        q = d if nx > 1 and fft(c, zero, d, zero, one, plane.x, tmp) == 1 else c
        for x in range(out_x):
            i, o = (plane.first_x + x) * 32, (x * pitch + ny - k) * 32
            store(middle, o, load16(q, i))
            store(middle, o + 16, load16(q, i + 16))
    low, high = modes_y // 2 + 1, ny - modes_y // 2
    for x in range(out_x):
        if flag[0]:
            return
        for o in range((x * pitch + low) * 32, (x * pitch + high) * 32):
            middle[o] = 0
        o = x * pitch * 32
        p = a if fft(middle, o, a, zero, one, plane.y, tmp) else middle
        o = 0 if plane.y.radices.size % 2 else o
        for y in range(out_y):
            at, i = (x * out_y + y) * depth + batch.start, o + (plane.first_y + y) * 32
            stream_store(image, at, load16(p, i), batch.non_temporal)
            if batch.number > 16:
                stream_store(image, at + 16, load16(p, i + 16), batch.non_temporal)
    store_fence()


@jit
def compact_rows(image: Any, lines: int, apart: int, depths: int) -> None:
    """Move rows of ``depths`` values with stride ``apart`` together, in place."""
    for line in range(1, lines):
        for n in range(0, depths, 16):  # what is written beyond a line's end lies before the next one's beginning
            store(image, line * depths + n, load16(image, line * apart + n))
