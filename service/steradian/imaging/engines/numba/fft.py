"""Vectorised FFTs of 16 signals at once (compiled).

A *cell* is 32 numbers: 16 real parts, then 16 imaginary parts. A transform of n cells is n consecutive cells; all 16
signals are transformed together, so that every operation is on whole vectors whatever the size. Stockham's self-sorting
algorithm, decimation in frequency. The inverse transform is the forward one with real and imaginary parts exchanged
(``re``, ``im`` are the offsets 0, 16 or 16, 0 inside the cell). Nothing is normalised.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from steradian.core.jit import jit_inline
from steradian.imaging.engines.numba.kernel_args import Factors
from steradian.imaging.engines.numba.simd import broadcast16, load16, store


class Pass(NamedTuple):
    """One FFT pass: offsets of real and imaginary parts, ``radix``, n_pass/radix, stride, and table offset."""

    re: int
    im: int
    radix: int
    m: int
    s: int
    twiddle: int
    generic: int


@jit_inline
def _pass2(x: Any, xo: int, y: Any, yo: int, at: Pass, tw: Any) -> None:
    re, im, _, m, s, to, _ = at
    for p in range(m):
        wr, wi = broadcast16(tw[to + 2 * p]), broadcast16(tw[to + 2 * p + 1])
        for q in range(s):
            i = xo + (q + s * p) * 32
            j = yo + (q + s * 2 * p) * 32
            ar, ai = load16(x, i + re), load16(x, i + im)
            i += s * m * 32
            br, bi = load16(x, i + re), load16(x, i + im)
            store(y, j + re, ar + br)
            store(y, j + im, ai + bi)
            dr, di = ar - br, ai - bi
            j += s * 32
            store(y, j + re, dr * wr - di * wi)
            store(y, j + im, dr * wi + di * wr)


@jit_inline
def _pass3(x: Any, xo: int, y: Any, yo: int, at: Pass, tw: Any) -> None:
    re, im, _, m, s, to, _ = at
    half, sine = broadcast16(x.dtype.type(0.5)), broadcast16(x.dtype.type(0.8660254037844386))
    for p in range(m):
        o = to + 4 * p
        w1r, w1i, w2r, w2i = broadcast16(tw[o]), broadcast16(tw[o + 1]), broadcast16(tw[o + 2]), broadcast16(tw[o + 3])
        for q in range(s):
            i = xo + (q + s * p) * 32
            j = yo + (q + s * 3 * p) * 32
            k = s * m * 32
            ar, ai = load16(x, i + re), load16(x, i + im)
            br, bi = load16(x, i + k + re), load16(x, i + k + im)
            cr, ci = load16(x, i + 2 * k + re), load16(x, i + 2 * k + im)
            tr, ti, ur, ui = br + cr, bi + ci, (br - cr) * sine, (bi - ci) * sine
            store(y, j + re, ar + tr)
            store(y, j + im, ai + ti)
            ar, ai = ar - half * tr, ai - half * ti
            br, bi = ar + ui, ai - ur
            cr, ci = ar - ui, ai + ur
            j += s * 32
            store(y, j + re, br * w1r - bi * w1i)
            store(y, j + im, br * w1i + bi * w1r)
            j += s * 32
            store(y, j + re, cr * w2r - ci * w2i)
            store(y, j + im, cr * w2i + ci * w2r)


@jit_inline
def _pass4(x: Any, xo: int, y: Any, yo: int, at: Pass, tw: Any) -> None:
    re, im, _, m, s, to, _ = at
    k = s * m * 32
    for p in range(m):
        o = to + 6 * p
        w1r, w1i, w2r, w2i = broadcast16(tw[o]), broadcast16(tw[o + 1]), broadcast16(tw[o + 2]), broadcast16(tw[o + 3])
        w3r, w3i = broadcast16(tw[o + 4]), broadcast16(tw[o + 5])
        for q in range(s):
            i = xo + (q + s * p) * 32
            j = yo + (q + s * 4 * p) * 32
            ar, ai = load16(x, i + re), load16(x, i + im)
            cr, ci = load16(x, i + 2 * k + re), load16(x, i + 2 * k + im)
            br, bi = load16(x, i + k + re), load16(x, i + k + im)
            dr, di = load16(x, i + 3 * k + re), load16(x, i + 3 * k + im)
            er, ei, fr, fi = ar + cr, ai + ci, ar - cr, ai - ci
            gr, gi, hr, hi = br + dr, bi + di, br - dr, bi - di
            store(y, j + re, er + gr)
            store(y, j + im, ei + gi)
            er, ei = er - gr, ei - gi
            ar, ai, br, bi = fr + hi, fi - hr, fr - hi, fi + hr
            j += s * 32
            store(y, j + re, ar * w1r - ai * w1i)
            store(y, j + im, ar * w1i + ai * w1r)
            j += s * 32
            store(y, j + re, er * w2r - ei * w2i)
            store(y, j + im, er * w2i + ei * w2r)
            j += s * 32
            store(y, j + re, br * w3r - bi * w3i)
            store(y, j + im, br * w3i + bi * w3r)


@jit_inline
def _pass5(x: Any, xo: int, y: Any, yo: int, at: Pass, tw: Any) -> None:
    re, im, _, m, s, to, _ = at
    c1, c2 = broadcast16(x.dtype.type(0.30901699437494745)), broadcast16(x.dtype.type(-0.8090169943749475))
    s1, s2 = broadcast16(x.dtype.type(0.9510565162951535)), broadcast16(x.dtype.type(0.5877852522924731))
    k = s * m * 32
    for p in range(m):
        o = to + 8 * p
        for q in range(s):
            i = xo + (q + s * p) * 32
            j = yo + (q + s * 5 * p) * 32
            ar, ai = load16(x, i + re), load16(x, i + im)
            br, bi = load16(x, i + k + re), load16(x, i + k + im)
            er, ei = load16(x, i + 4 * k + re), load16(x, i + 4 * k + im)
            tr, ti, ur, ui = br + er, bi + ei, br - er, bi - ei
            cr, ci = load16(x, i + 2 * k + re), load16(x, i + 2 * k + im)
            dr, di = load16(x, i + 3 * k + re), load16(x, i + 3 * k + im)
            vr, vi, zr, zi = cr + dr, ci + di, cr - dr, ci - di
            store(y, j + re, ar + tr + vr)
            store(y, j + im, ai + ti + vi)
            br, bi = ar + c1 * tr + c2 * vr, ai + c1 * ti + c2 * vi
            cr, ci = s1 * ur + s2 * zr, s1 * ui + s2 * zi
            dr, di = ar + c2 * tr + c1 * vr, ai + c2 * ti + c1 * vi
            er, ei = s2 * ur - s1 * zr, s2 * ui - s1 * zi
            j += s * 32
            gr, gi = br + ci, bi - cr
            wr, wi = broadcast16(tw[o]), broadcast16(tw[o + 1])
            store(y, j + re, gr * wr - gi * wi)
            store(y, j + im, gr * wi + gi * wr)
            j += s * 32
            gr, gi = dr + ei, di - er
            wr, wi = broadcast16(tw[o + 2]), broadcast16(tw[o + 3])
            store(y, j + re, gr * wr - gi * wi)
            store(y, j + im, gr * wi + gi * wr)
            j += s * 32
            gr, gi = dr - ei, di + er
            wr, wi = broadcast16(tw[o + 4]), broadcast16(tw[o + 5])
            store(y, j + re, gr * wr - gi * wi)
            store(y, j + im, gr * wi + gi * wr)
            j += s * 32
            gr, gi = br - ci, bi + cr
            wr, wi = broadcast16(tw[o + 6]), broadcast16(tw[o + 7])
            store(y, j + re, gr * wr - gi * wi)
            store(y, j + im, gr * wi + gi * wr)


@jit_inline
def _twiddle_multiply(y: Any, j: int, re: int, im: int, ar: Any, ai: Any, tw: Any, o: int) -> None:
    wr, wi = broadcast16(tw[o]), broadcast16(tw[o + 1])
    store(y, j + re, ar * wr - ai * wi)
    store(y, j + im, ar * wi + ai * wr)


@jit_inline
def _pass8(x: Any, xo: int, y: Any, yo: int, at: Pass, tw: Any) -> None:
    re, im, _, m, s, to, _ = at
    k, t = s * m * 32, s * 32
    root = broadcast16(x.dtype.type(0.7071067811865476))
    for p in range(m):
        o = to + 14 * p
        for q in range(s):
            i = xo + (q + s * p) * 32
            j = yo + (q + s * 8 * p) * 32
            ar, ai = load16(x, i + re), load16(x, i + im)
            br, bi = load16(x, i + 4 * k + re), load16(x, i + 4 * k + im)
            cr, ci = load16(x, i + 2 * k + re), load16(x, i + 2 * k + im)
            dr, di = load16(x, i + 6 * k + re), load16(x, i + 6 * k + im)
            er, ei, fr, fi = ar + br, ai + bi, ar - br, ai - bi
            gr, gi, hr, hi = cr + dr, ci + di, cr - dr, ci - di
            e0r, e0i, e2r, e2i = er + gr, ei + gi, er - gr, ei - gi
            e1r, e1i, e3r, e3i = fr + hi, fi - hr, fr - hi, fi + hr
            ar, ai = load16(x, i + k + re), load16(x, i + k + im)
            br, bi = load16(x, i + 5 * k + re), load16(x, i + 5 * k + im)
            cr, ci = load16(x, i + 3 * k + re), load16(x, i + 3 * k + im)
            dr, di = load16(x, i + 7 * k + re), load16(x, i + 7 * k + im)
            er, ei, fr, fi = ar + br, ai + bi, ar - br, ai - bi
            gr, gi, hr, hi = cr + dr, ci + di, cr - dr, ci - di
            ar, ai, cr, ci = er + gr, ei + gi, ei - gi, gr - er
            br, bi, dr, di = fr + hi, fi - hr, fr - hi, fi + hr
            br, bi = (br + bi) * root, (bi - br) * root
            dr, di = (di - dr) * root, (broadcast16(x.dtype.type(0.0)) - dr - di) * root
            store(y, j + re, e0r + ar)
            store(y, j + im, e0i + ai)
            _twiddle_multiply(y, j + t, re, im, e1r + br, e1i + bi, tw, o)
            _twiddle_multiply(y, j + 2 * t, re, im, e2r + cr, e2i + ci, tw, o + 2)
            _twiddle_multiply(y, j + 3 * t, re, im, e3r + dr, e3i + di, tw, o + 4)
            _twiddle_multiply(y, j + 4 * t, re, im, e0r - ar, e0i - ai, tw, o + 6)
            _twiddle_multiply(y, j + 5 * t, re, im, e1r - br, e1i - bi, tw, o + 8)
            _twiddle_multiply(y, j + 6 * t, re, im, e2r - cr, e2i - ci, tw, o + 10)
            _twiddle_multiply(y, j + 7 * t, re, im, e3r - dr, e3i - di, tw, o + 12)


@jit_inline
def _generic(x: Any, xo: int, y: Any, yo: int, at: Pass, t: Factors, tmp: Any) -> None:
    """Butterfly of odd radix r: pairs n, r−n share their products, so r²/4 complex products a transform."""
    re, im, r, m, s, to, co = at
    tw, cs = t.twiddles, t.generic
    h = r // 2
    k, step = s * m * 32, s * 32
    for p in range(m):
        o = to + 2 * (r - 1) * p - 2
        for q in range(s):
            i = xo + (q + s * p) * 32
            j = yo + (q + s * r * p) * 32
            ar, ai = load16(x, i + re), load16(x, i + im)
            tr, ti = ar, ai
            for n in range(1, h + 1):
                br, bi = load16(x, i + n * k + re), load16(x, i + n * k + im)
                cr, ci = load16(x, i + (r - n) * k + re), load16(x, i + (r - n) * k + im)
                er, ei = br + cr, bi + ci
                store(tmp, (n - 1) * 64, er)
                store(tmp, (n - 1) * 64 + 16, ei)
                store(tmp, (n - 1) * 64 + 32, br - cr)
                store(tmp, (n - 1) * 64 + 48, bi - ci)
                tr, ti = tr + er, ti + ei
            store(y, j + re, tr)
            store(y, j + im, ti)
            c = co
            for a in range(1, h + 1, 2):
                zero = broadcast16(x.dtype.type(0.0))
                er, ei, fr, fi, gr, gi, hr, hi = ar, ai, zero, zero, ar, ai, zero, zero
                for n in range(h):
                    br, bi = load16(tmp, n * 64), load16(tmp, n * 64 + 16)
                    dr, di = load16(tmp, n * 64 + 32), load16(tmp, n * 64 + 48)
                    w = broadcast16(cs[c])
                    er, ei = er + w * br, ei + w * bi
                    w = broadcast16(cs[c + 1])
                    fr, fi = fr + w * dr, fi + w * di
                    w = broadcast16(cs[c + 2])
                    gr, gi = gr + w * br, gi + w * bi
                    w = broadcast16(cs[c + 3])
                    hr, hi = hr + w * dr, hi + w * di
                    c += 4
                _twiddle_multiply(y, j + a * step, re, im, er + fi, ei - fr, tw, o + 2 * a)
                _twiddle_multiply(y, j + (r - a) * step, re, im, er - fi, ei + fr, tw, o + 2 * (r - a))
                if a + 1 <= h:
                    b = a + 1
                    _twiddle_multiply(y, j + b * step, re, im, gr + hi, gi - hr, tw, o + 2 * b)
                    _twiddle_multiply(y, j + (r - b) * step, re, im, gr - hi, gi + hr, tw, o + 2 * (r - b))


@jit_inline
def fft(a: Any, ao: int, b: Any, bo: int, inverse: int, t: Factors, tmp: Any) -> int:
    """Compute an FFT of cells at ``a[ao:]`` with buffer ``b[bo:]``; return 0 if the result is in a, 1 if in b.

    Call it with variables of type int64: Numba compiles another version for every literal number.
    """
    re, im = (16, 0) if inverse else (0, 16)
    s: Any = np.int64(1)
    length, flip = t.size, 0
    radices, twiddles, twiddle_starts, generic_starts = t.radices, t.twiddles, t.twiddle_starts, t.generic_starts
    x, xo, y, yo = a, ao, b, bo
    for i in range(radices.size):
        r = radices[i]
        m = length // r
        at = Pass(re, im, r, m, s, twiddle_starts[i], generic_starts[i])
        if r == 8:
            _pass8(x, xo, y, yo, at, twiddles)
        elif r == 4:
            _pass4(x, xo, y, yo, at, twiddles)
        elif r == 5:
            _pass5(x, xo, y, yo, at, twiddles)
        elif r == 3:
            _pass3(x, xo, y, yo, at, twiddles)
        elif r == 2:
            _pass2(x, xo, y, yo, at, twiddles)
        else:
            _generic(x, xo, y, yo, at, t, tmp)
        x, y = y, x
        xo, yo = yo, xo
        s *= r
        length = m
        flip = 1 - flip
    return flip
