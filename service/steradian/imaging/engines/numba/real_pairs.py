"""FFT of two real batches as one complex transform, separated by Hermitian symmetry.

Rows of modes are filled up to a multiple of 16 numbers, so that all of a batch is whole vectors. The filling has to be
of real data as well (zeros, or depths that nobody asked for): else it would mix with the other half of its batch. Whole
lines of modes at a time: a call counts the references to all arrays it takes, which costs far more than a cell.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from steradian.core.jit import jit_inline
from steradian.imaging.engines.numba.kernel_args import Batch
from steradian.imaging.engines.numba.simd import broadcast16, load16, store, stream_store


class CellIndex(NamedTuple):
    """Index of FFT cells: ``index[i]`` of ``values``, counted from number ``start``."""

    values: Any
    start: int
    index: Any


@jit_inline
def split_real_pair(here: CellIndex, opposite: CellIndex, row: Any, batch: Batch, at: int, add: bool) -> None:
    """Store or add the spectra Â and B̂ of two real signals, separated from C = Â + iB̂, without the factor ½.

    The first mode's real parts of this batch are at ``row[at:]``, the imaginary ones a row further, the next mode's two
    rows further.
    """
    p, q, stride, two, past = here.values, opposite.values, batch.stride, batch.number > 16, batch.non_temporal
    for i in range(here.index.size):
        po, qo, im_at = here.start + here.index[i] * 32, opposite.start + opposite.index[i] * 32, at + stride
        ar, ai, br, bi = load16(p, po), load16(p, po + 16), load16(q, qo), load16(q, qo + 16)
        if add:
            store(row, at, load16(row, at) + ar + br)
            store(row, im_at, load16(row, im_at) + ai - bi)
            if two:
                store(row, at + 16, load16(row, at + 16) + ai + bi)
                store(row, im_at + 16, load16(row, im_at + 16) + br - ar)
        else:
            stream_store(row, at, ar + br, past)
            stream_store(row, im_at, ai - bi, past)
            if two:
                stream_store(row, at + 16, ai + bi, past)
                stream_store(row, im_at + 16, br - ar, past)
        at += 2 * stride


@jit_inline
def merge_real_pair(source: Any, at: int, batch: Batch, modes: int, p: Any, q: Any, size: int, edges: bool) -> None:
    """Combine two spectra to C = Â + iB̂ for one line of modes, from ``source[at:]`` into p and (−j) into q.

    What is at N/2 counts as 0 without ``edges``.
    """
    stride, two, nothing = batch.stride, batch.number > 16, broadcast16(p.dtype.type(0.0))
    if size > modes or not edges:
        p[: size * 32] = 0
        q[: size * 32] = 0
    for i in range(modes):
        if edges or modes == 1 or 2 * i != modes:
            po = (i if 2 * i < modes else size - modes + i) * 32
            o = 0 if i == 0 else modes - i
            qo = (o if 2 * o < modes else size - modes + o) * 32
            ar, ai = load16(source, at), load16(source, at + stride)
            br, bi = nothing, nothing
            if two:
                br, bi = load16(source, at + 16), load16(source, at + stride + 16)
            store(p, po, ar - bi)
            store(p, po + 16, ai + br)
            store(q, qo, ar + bi)
            store(q, qo + 16, br - ai)
        at += 2 * stride
