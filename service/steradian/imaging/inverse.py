"""Lateral modes to image, one batch of 32 depths at a time (compiled).

Two vectors of 16 depths are one complex lateral grid again, whose inverse transform has the first 16 images as real and
the others as imaginary part. A batch reads its depths of all columns before it writes the same depths of the image, so
both may share one block of memory.
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
        for n in range(count):
            p[po + n] = source[at + n]
            q[qo + n] = source[at + stride + n]
        for n in range(count, 32):
            p[po + n] = 0
            q[qo + n] = 0
        ar, br, ai, bi = load16(p, po), load16(p, po + 16), load16(q, qo), load16(q, qo + 16)
    else:
        ar, br = load16(source, at), load16(source, at + 16)
        ai, bi = load16(source, at + stride), load16(source, at + stride + 16)
    store(p, po, ar - bi)
    store(p, po + 16, ai + br)
    store(q, qo, ar + bi)
    store(q, qo + 16, br - ai)


@compiled
def _halve(a: Any, i: int, j: int) -> None:
    """Split the Nyquist cell i between i and j."""
    half = splat16(a.dtype.type(0.5))
    for o in (0, 16):
        v = load16(a, i + o) * half
        store(a, i + o, v)
        store(a, j + o, v)


@compiled
def backward(
    source: Any, stride: int, start: int, count: int, modes_x: int, modes_y: int, nx: int, ny: int,
    first_x: int, out_x: int, first_y: int, out_y: int, fx: Any, fy: Any, flag: Any,
    a: Any, b: Any, c: Any, d: Any, middle: Any, tmp: Any, image: Any, depth: int,
) -> None:  # fmt: skip
    """Image points of ``count`` depths from ``start``, for the rows first_x … and columns first_y … of an nx × ny grid.

    ``image`` is flat [x][y][z] with ``depth`` values a line. nx, ny ≥ the modes: more of them interpolate.
    """
    half = modes_y // 2 + 1
    zero, one = np.int64(0), np.int64(1)
    for k in range(half):
        if flag[0]:
            return
        if nx > modes_x:
            a[: nx * 32] = 0
            c[: nx * 32] = 0
        for i in range(modes_x):
            at = 2 * (i * half + k) * stride + start
            j = i if 2 * i < modes_x else nx - modes_x + i
            o = 0 if i == 0 else modes_x - i
            o = o if 2 * o < modes_x else nx - modes_x + o
            _join(source, at, stride, count, a, j * 32, c, o * 32)
        if nx > modes_x and modes_x % 2 == 0:
            _halve(a, (nx - modes_x // 2) * 32, modes_x // 2 * 32)
            _halve(c, (nx - modes_x // 2) * 32, modes_x // 2 * 32)
        p = b if nx > 1 and fft(a, zero, b, zero, one, nx, fx[0], fx[1], fx[2], fx[3], fx[4], tmp) == 1 else a
        nyquist = 2 * k == modes_y
        if nyquist and ny > modes_y:
            for x in range(out_x):
                i, o = (first_x + x) * 32, (x * ny + k) * 32
                store(middle, o, load16(p, i))
                store(middle, o + 16, load16(p, i + 16))
                _halve(middle, o, (x * ny + ny - k) * 32)
            continue
        for x in range(out_x):
            i, o = (first_x + x) * 32, (x * ny + k) * 32
            store(middle, o, load16(p, i))
            store(middle, o + 16, load16(p, i + 16))
        if k == 0 or nyquist:
            continue
        q = d if nx > 1 and fft(c, zero, d, zero, one, nx, fx[0], fx[1], fx[2], fx[3], fx[4], tmp) == 1 else c
        for x in range(out_x):
            i, o = (first_x + x) * 32, (x * ny + ny - k) * 32
            store(middle, o, load16(q, i))
            store(middle, o + 16, load16(q, i + 16))
    low, high = modes_y // 2 + 1, ny - modes_y // 2
    for x in range(out_x):
        if flag[0]:
            return
        for o in range((x * ny + low) * 32, (x * ny + high) * 32):
            middle[o] = 0
        o = x * ny * 32
        p = a if fft(middle, o, a, zero, one, ny, fy[0], fy[1], fy[2], fy[3], fy[4], tmp) else middle
        o = 0 if fy[0].size % 2 else o
        for y in range(out_y):
            at, i = (x * out_y + y) * depth + start, o + (first_y + y) * 32
            if count == 32:
                store(image, at, load16(p, i))
                store(image, at + 16, load16(p, i + 16))
            else:
                for n in range(count):
                    image[at + n] = p[i + n]
