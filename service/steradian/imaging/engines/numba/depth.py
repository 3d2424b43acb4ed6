"""Compiled time-to-depth transform of 16 lateral modes at once, and its adjoint.

Per mode: window and transform over time, interpolation at κ (paper, NER-NUFFT, equation 5), the factor of
:class:`steradian.imaging.transforms.time_to_depth.KappaMap`, inverse transform over depth; all within the processor's
second cache. Four modes (two, if κ grows differently along x and y; one in 2-D) with the same |j|² share one stencil.
The two ways are each other's transposes to rounding, whatever the window's accuracy.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from steradian.core.jit import jit, jit_inline
from steradian.imaging.engines.numba.constants import CELL_PADDING, DEPTH_CHUNK
from steradian.imaging.engines.numba.fft import fft
from steradian.imaging.engines.numba.kernel_args import AxisTransform, DepthWorkspace, KappaMap
from steradian.imaging.engines.numba.response_interpolation import interpolate_response
from steradian.imaging.engines.numba.simd import (
    broadcast16,
    load1,
    load2,
    load4,
    load16,
    splat1,
    splat2,
    splat4,
    store,
    transpose_gather,
    transpose_scatter,
)


class DepthChunk(NamedTuple):
    """Values of l, ``number`` ≤ PIECE from ``first``, of modes from ``lane``; transforms of ``length`` and ``size``."""

    first: int
    number: int
    lane: int
    length: int
    size: int


@jit_inline
def _load_columns(side: AxisTransform, block: int, x: Any, xo: int, tmp: Any) -> None:
    """Load n values of 16 columns into the FFT's cells, times window and factor; other cells are 0."""
    rows, imaginary, count, length = side.real[block], side.imaginary[block], side.number, side.transform.size
    multiplied = side.window.size > 0
    one, nothing = broadcast16(x.dtype.type(1.0)), broadcast16(x.dtype.type(0.0))
    rr, ri, ir, ii = one, one, one, one
    if multiplied:
        f = side.factors[block]
        rr, ri, ir, ii = load16(f, 0), load16(f, 16), load16(f, 32), load16(f, 48)
    for start in range(0, count, 16):
        transpose_gather(side.values, rows, start, tmp, 0)
        transpose_gather(side.values, imaginary, start, tmp, 16)
        for n in range(min(16, count - start)):
            cell = start + n - side.centre
            o = xo + (cell if cell >= 0 else cell + length) * 32
            a, b = load16(tmp, n * 32), load16(tmp, n * 32 + 16)
            if multiplied:
                w = broadcast16(side.window[start + n])
                a, b = a * w, b * w
                a, b = a * rr + b * ri, a * ir + b * ii
            store(x, o, a)
            store(x, o + 16, b)
    for n in range(count, length):
        cell = n - side.centre
        o = xo + (cell if cell < length else cell - length) * 32
        store(x, o, nothing)
        store(x, o + 16, nothing)


@jit_inline
def _store_columns(x: Any, xo: int, side: AxisTransform, block: int, tmp: Any) -> None:
    """Inverse of :func:`_load_columns`; padding after a row's end is filled with the next values in x, or 0."""
    rows, imaginary, count, length = side.real[block], side.imaginary[block], side.number, side.transform.size
    multiplied = side.window.size > 0
    one, nothing = broadcast16(x.dtype.type(1.0)), broadcast16(x.dtype.type(0.0))
    rr, ri, ir, ii = one, one, one, one
    if multiplied:
        f = side.factors[block]
        rr, ri, ir, ii = load16(f, 0), load16(f, 16), load16(f, 32), load16(f, 48)
    for start in range(0, count, 16):
        values, o = x, xo + (start - side.centre) * 32  # without a factor nothing wraps round
        if multiplied:
            values, o = tmp, 0
            for n in range(max(0, count - start), 16):
                store(tmp, n * 32, nothing)
                store(tmp, n * 32 + 16, nothing)
            for n in range(min(16, count - start)):
                w = broadcast16(side.window[start + n])
                cell = start + n - side.centre
                i = xo + (cell if cell >= 0 else cell + length) * 32
                a, b = load16(x, i) * w, load16(x, i + 16) * w
                store(tmp, n * 32, a * rr + b * ir)
                store(tmp, n * 32 + 16, a * ri + b * ii)
        transpose_scatter(values, o, side.values, rows, start)
        transpose_scatter(values, o + 16, side.values, imaginary, start)


@jit_inline
def _count_in_band(square: float, band: float) -> int:
    """Return the number of values of l with κ < band."""
    return int(np.ceil(np.sqrt(band * band - square))) if square < band * band else 0


@jit_inline
def _layer_phase(rule: KappaMap, kappa2: float, square: float, l: float) -> tuple[float, float]:  # noqa: E741
    """Return the phase of the layers above in turns, and 1, or 0 where the wave is evanescent in one of them."""
    turn, gained = -rule.shift * l, 1.0
    for i in range(rule.overlying.shape[0]):
        root = rule.overlying[i, 0] * kappa2 - rule.overlying[i, 1] * square
        if root > 0:
            turn += np.sqrt(root)
        else:
            gained = 0.0
    return turn - np.rint(turn), gained


@jit_inline
def _stencils(square: float, part: DepthChunk, rule: KappaMap, space: DepthWorkspace) -> None:
    """Compute first grid points, taps and factors for a chunk of values of l.

    The factor's real and minus imaginary part are left in ``gain`` and ``phase``.
    """
    index, fraction, phase, gain, taps = space.index, space.fraction, space.phase, space.gain, space.taps
    polynomials, sine, cosine, table, steps = rule.polynomials, rule.sine, rule.cosine, rule.table, rule.steps
    width, nearest, ratio, turns, both = polynomials.shape[0], rule.nearest, rule.ratio, rule.turns, rule.both
    first, count = part.first, part.number
    lead = 0.5 - 0.5 * width if nearest else -0.5 * width
    for n in range(count):
        l = float(first + n)  # noqa: E741
        kappa = np.sqrt(l * l + square)
        u = kappa * ratio + (0.0 if nearest else lead)
        whole = np.floor(u + 0.5) if nearest else np.floor(u)
        index[n] = np.int32(whole) + (0 if nearest else 1)
        fraction[n] = 2.0 * (u - whole) - 1.0
        turn = kappa * turns
        phase[n] = turn - np.rint(turn)
        gain[n] = 0.5 if both else (2.0 * l / kappa if kappa > 0 else 2.0)
    if table.shape[1] > 1:
        for n in range(count):
            kappa = np.sqrt(float(first + n) * float(first + n) + square)
            amplitude, turn = interpolate_response(table, steps, square, kappa)
            gain[n] *= amplitude
            phase[n] -= turn + np.rint(phase[n] - turn)
    if rule.overlying.shape[0] > 0:
        for n in range(count):
            l = float(first + n)  # noqa: E741
            turn, gained = _layer_phase(rule, l * l + square, square, l)
            gain[n] *= gained
            phase[n] -= turn + np.rint(phase[n] - turn)
    degree = polynomials.shape[1] - 1
    pi = broadcast16(fraction.dtype.type(np.pi))
    for o in range(0, count, 16):
        y = load16(fraction, o)
        for t in range(width):
            value = broadcast16(polynomials[t, degree])
            for d in range(degree - 1, -1, -1):
                value = value * y + broadcast16(polynomials[t, d])
            store(taps, t * DEPTH_CHUNK + o, value)
        # half angles, so that the series converge fast: cos 2a = 1 − 2 sin² a, sin 2a = 2 sin a cos a
        a = load16(phase, o) * pi
        a2 = a * a
        s, c = broadcast16(sine[sine.size - 1]), broadcast16(cosine[cosine.size - 1])
        for d in range(sine.size - 2, -1, -1):
            s, c = s * a2 + broadcast16(sine[d]), c * a2 + broadcast16(cosine[d])
        s = s * a
        g = load16(gain, o)
        two = broadcast16(fraction.dtype.type(2.0)) * s * g
        store(gain, o, g - two * s)
        store(phase, o, two * c)


def _build_gather_scatter(load: Any, splat: Any) -> tuple[Any, Any]:
    """Return the gather and spread kernels for groups of as many modes as ``load`` reads lanes."""

    def gather(x: Any, h: Any, part: DepthChunk, rule: KappaMap, space: DepthWorkspace) -> None:
        """Interpolate depth frequencies H(±l) of a group of modes from the time spectrum X(±κ)."""
        index, phase, gain, taps = space.index, space.phase, space.gain, space.taps
        width, both, zero = rule.polynomials.shape[0], rule.both, splat(x.dtype.type(0.0))
        for n in range(part.number):
            i = (CELL_PADDING + index[n]) * 32 + part.lane
            j = (CELL_PADDING + part.length - index[n]) * 32 + part.lane
            ar, ai, br, bi = zero, zero, zero, zero
            for t in range(width):
                w = splat(taps[t * DEPTH_CHUNK + n])
                ar = ar + w * load(x, i)
                ai = ai + w * load(x, i + 16)
                br = br + w * load(x, j)
                bi = bi + w * load(x, j + 16)
                i += 32
                j -= 32
            c, s = splat(gain[n]), splat(phase[n])
            ar, ai, br, bi = ar * c + ai * s, ai * c - ar * s, br * c - bi * s, bi * c + br * s
            if both:
                ar, ai = ar + br, ai + bi
                br, bi = ar, ai
            l = part.first + n  # noqa: E741
            store(h, l * 32 + part.lane, ar)
            store(h, l * 32 + part.lane + 16, ai)
            if l > 0:
                o = (part.size - l) * 32 + part.lane
                store(h, o, br)
                store(h, o + 16, bi)

    def spread(h: Any, x: Any, part: DepthChunk, rule: KappaMap, space: DepthWorkspace) -> None:
        """Add H(l) and H(−l) of a group of modes to the time spectrum X(±κ): adjoint of gather."""
        index, phase, gain, taps = space.index, space.phase, space.gain, space.taps
        width, both, zero = rule.polynomials.shape[0], rule.both, splat(x.dtype.type(0.0))
        for n in range(part.number):
            l = part.first + n  # noqa: E741
            ar, ai = load(h, l * 32 + part.lane), load(h, l * 32 + part.lane + 16)
            br, bi = zero, zero
            if l > 0:
                o = (part.size - l) * 32 + part.lane
                br, bi = load(h, o), load(h, o + 16)
            if both:
                ar, ai = ar + br, ai + bi
                br, bi = ar, ai
            c, s = splat(gain[n]), splat(phase[n])
            ar, ai, br, bi = ar * c - ai * s, ai * c + ar * s, br * c + bi * s, bi * c - br * s
            i = (CELL_PADDING + index[n]) * 32 + part.lane
            j = (CELL_PADDING + part.length - index[n]) * 32 + part.lane
            for t in range(width):
                w = splat(taps[t * DEPTH_CHUNK + n])
                store(x, i, load(x, i) + w * ar)
                store(x, i + 16, load(x, i + 16) + w * ai)
                store(x, j, load(x, j) + w * br)
                store(x, j + 16, load(x, j + 16) + w * bi)
                i += 32
                j -= 32

    return jit_inline(gather, kept=False), jit_inline(spread, kept=False)


_gather4, _spread4 = _build_gather_scatter(load4, splat4)
_gather2, _spread2 = _build_gather_scatter(load2, splat2)
_gather1, _spread1 = _build_gather_scatter(load1, splat1)


@jit
def to_depth(
    first: int, last: int, time: AxisTransform, depth: AxisTransform, rule: KappaMap, space: DepthWorkspace, flag: Any
) -> None:
    """Transform blocks ``first`` … ``last`` of 16 columns from time to depth."""
    a, b, tmp, squares = space.a, space.b, space.tmp, rule.squares
    length, size = time.transform.size, depth.transform.size
    xo, lanes = np.int64(CELL_PADDING * 32), 16 // squares.shape[1]
    zero, one = np.int64(0), np.int64(1)
    nothing = broadcast16(a.dtype.type(0.0))
    for block in range(first, last):
        if flag[0]:
            return
        _load_columns(time, block, a, xo, tmp)
        flip = fft(a, xo, b, xo, zero, time.transform, tmp)
        x, h = (b, a) if flip else (a, b)
        for o in range(0, CELL_PADDING * 32, 16):
            store(x, o, load16(x, length * 32 + o))
            store(x, xo + length * 32 + o, load16(x, xo + o))
        low, high = size, 0
        for group in range(squares.shape[1]):
            reach = _count_in_band(squares[block, group], rule.band)
            low, high = min(low, reach), max(high, reach)
        for o in range(low * 32, (size - max(low, 1) + 1) * 32, 16):
            store(h, o, nothing)
        for start in range(0, high, DEPTH_CHUNK):
            for group in range(squares.shape[1]):
                square, lane = squares[block, group], lanes * group
                count = min(DEPTH_CHUNK, _count_in_band(square, rule.band) - start)
                if count <= 0:
                    continue
                part = DepthChunk(start, count, lane, length, size)
                _stencils(square, part, rule, space)
                if lanes == 4:
                    _gather4(x, h, part, rule, space)
                elif lanes == 2:
                    _gather2(x, h, part, rule, space)
                else:
                    _gather1(x, h, part, rule, space)
                if rule.edges[block, group]:
                    for l in range(max(start, 1), start + count):  # noqa: E741
                        for e in range(lane - lane % 2, lane + lanes, 2):
                            o = (size - l) * 32 + e
                            h[o] = h[o + 1]
                            h[o + 16] = h[o + 17]
        result = x if fft(h, zero, x, zero, one, depth.transform, tmp) else h
        for o in range(size * 32, (size + 16) * 32, 16):
            store(result, o, nothing)
        _store_columns(result, zero, depth, block, tmp)


@jit
def to_time(
    first: int, last: int, time: AxisTransform, depth: AxisTransform, rule: KappaMap, space: DepthWorkspace, flag: Any
) -> None:
    """Transform blocks ``first`` … ``last`` of 16 columns from depth to time: the adjoint, without edges."""
    a, b, tmp, squares = space.a, space.b, space.tmp, rule.squares
    length, size = time.transform.size, depth.transform.size
    xo, lanes = np.int64(CELL_PADDING * 32), 16 // squares.shape[1]
    zero, one = np.int64(0), np.int64(1)
    nothing = broadcast16(a.dtype.type(0.0))
    for block in range(first, last):
        if flag[0]:
            return
        _load_columns(depth, block, a, zero, tmp)
        flip = fft(a, zero, b, zero, zero, depth.transform, tmp)
        h, x = (b, a) if flip else (a, b)
        for o in range(0, (length + 2 * CELL_PADDING) * 32, 16):
            store(x, o, nothing)
        for group in range(squares.shape[1]):
            square, lane = squares[block, group], lanes * group
            reach = _count_in_band(square, rule.band)
            for start in range(0, reach, DEPTH_CHUNK):
                part = DepthChunk(start, min(DEPTH_CHUNK, reach - start), lane, length, size)
                _stencils(square, part, rule, space)
                if lanes == 4:
                    _spread4(h, x, part, rule, space)
                elif lanes == 2:
                    _spread2(h, x, part, rule, space)
                else:
                    _spread1(h, x, part, rule, space)
        for o in range(0, CELL_PADDING * 32, 16):
            i = xo + (length - CELL_PADDING) * 32 + o
            store(x, i, load16(x, i) + load16(x, o))
            store(x, xo + o, load16(x, xo + o) + load16(x, xo + length * 32 + o))
        result = h if fft(x, xo, h, xo, one, time.transform, tmp) else x
        _store_columns(result, xo, time, block, tmp)
