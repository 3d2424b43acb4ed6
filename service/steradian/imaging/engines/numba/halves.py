"""Two batches of real data as one complex grid, and apart again by symmetry (compiled)."""

from __future__ import annotations

from typing import Any

from steradian.compiled import compiled
from steradian.imaging.engines.numba.arguments import Batch
from steradian.imaging.engines.numba.simd import load16, store


@compiled
def separate(p: Any, po: int, q: Any, qo: int, row: Any, batch: Batch, at: int, add: bool) -> None:
    """Write, or add, Â and B̂ at one mode from C there (p) and at the opposite mode (q); the factor 2 is left in.

    The mode's real parts of this batch are at ``row[at:]``, the imaginary ones a row further.
    """
    im_at, count = at + batch.stride, batch.number
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
def join(source: Any, at: int, batch: Batch, p: Any, po: int, q: Any, qo: int) -> None:
    """C = Â + iB̂ at one mode into p and at the opposite mode into q."""
    count, stride = batch.number, batch.stride
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
