"""Depth to time and its transpose for 16 lateral modes at once (compiled): the wave equation, forwards.

A lateral mode of initial pressure f(z) above the film makes there the pressure

    p(n) = Σ_{l ≥ 0} m_l · |S(κ)| cos(2πκ(n + t₀)/L + arg S(κ)) · Σ_z f(z) cos(2πlz/L),  m_0 = 1, else 2

with κ = √(l² + |j|²) as in the paper's equation 4 and S the film's response. The cosine sums over l are a transform
over depth, those over κ one over time onto an oversampled grid with an interpolation between (paper, section 3). Here
both signs of l go the same way: unlike the inversion formula, which takes the waves that come up for all there are,
this is exact. The two kernels are each other's transposes to rounding, whatever the window's accuracy.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from steradian.compiled import compiled
from steradian.imaging.fft import fft
from steradian.imaging.lookup import look_up
from steradian.imaging.simd import (
    collect,
    distribute,
    load1,
    load2,
    load4,
    load16,
    splat1,
    splat2,
    splat4,
    splat16,
    store,
)

PAD = 24  # cells repeated at either end of the spectrum, so that no stencil has to wrap


@compiled
def _bring(
    source: Any, rows: Any, imaginary: Any, count: int, centre: int, length: int, window: Any, factors: Any,
    x: Any, xo: int, tmp: Any,
) -> None:  # fmt: skip
    """Bring ``count`` numbers n of 16 columns, times window and factor, at cell (n − centre) mod length; others 0."""
    for o in range(xo, xo + length * 32, 16):
        store(x, o, splat16(x.dtype.type(0.0)))
    f = load16(factors, 0)
    for start in range(0, count, 16):
        some = min(16, count - start)
        if some == 16:
            collect(source, rows, start, tmp, 0)
            collect(source, imaginary, start, tmp, 16)
        else:
            for lane in range(16):
                for n in range(some):
                    tmp[n * 32 + lane] = source[rows[lane] + start + n]
                    tmp[n * 32 + 16 + lane] = source[imaginary[lane] + start + n]
        for n in range(some):
            w = splat16(window[start + n]) * f
            cell = start + n - centre
            o = xo + (cell if cell >= 0 else cell + length) * 32
            store(x, o, load16(tmp, n * 32) * w)
            store(x, o + 16, load16(tmp, n * 32 + 16) * w)


@compiled
def _take(
    x: Any, xo: int, count: int, centre: int, length: int, window: Any, factors: Any, target: Any, rows: Any,
    imaginary: Any, tmp: Any,
) -> None:  # fmt: skip
    """Do the way back of :func:`_bring`."""
    f = load16(factors, 0)
    for start in range(0, count, 16):
        some = min(16, count - start)
        for n in range(some):
            w = splat16(window[start + n]) * f
            cell = start + n - centre
            o = xo + (cell if cell >= 0 else cell + length) * 32
            store(tmp, n * 32, load16(x, o) * w)
            store(tmp, n * 32 + 16, load16(x, o + 16) * w)
        if some == 16:
            distribute(tmp, 0, target, rows, start)
            distribute(tmp, 16, target, imaginary, start)
        else:
            for lane in range(16):
                for n in range(some):
                    target[rows[lane] + start + n] = tmp[n * 32 + lane]
                    target[imaginary[lane] + start + n] = tmp[n * 32 + 16 + lane]


@compiled
def _stencils(
    square: float, band: float, ratio: float, turns: float, table: Any, steps: Any, width: int, taps_of: Any,
    sine: Any, cosine: Any, index: Any, fraction: Any, phase: Any, gain: Any, taps: Any, pitch: int,
) -> int:  # fmt: skip
    """First grid points, taps and ½S(κ)·e^{2πi·turns·κ} of all l with κ < band; how many these are.

    The complex factor is left in ``gain`` (real part) and ``phase`` (imaginary part).
    """
    if square >= band * band:
        return 0
    count = int(np.ceil(np.sqrt(band * band - square)))
    for l in range(count):  # noqa: E741
        kappa = np.sqrt(float(l) * float(l) + square)
        u = kappa * ratio - 0.5 * width
        whole = np.floor(u)
        index[l] = np.int32(whole) + 1
        fraction[l] = 2.0 * (u - whole) - 1.0
        turn, size = kappa * turns, 0.5
        if table.shape[1] > 1:
            amplitude, more = look_up(table, steps, square, kappa)
            turn, size = turn + more, 0.5 * amplitude
        phase[l] = turn - np.rint(turn)
        gain[l] = size
    degree = taps_of.shape[1] - 1
    pi = splat16(fraction.dtype.type(np.pi))
    for o in range(0, count, 16):
        y = load16(fraction, o)
        for t in range(width):
            value = splat16(taps_of[t, degree])
            for d in range(degree - 1, -1, -1):
                value = value * y + splat16(taps_of[t, d])
            store(taps, t * pitch + o, value)
        # half angles, so that the series converge fast: cos 2a = 1 − 2 sin² a, sin 2a = 2 sin a cos a
        a = load16(phase, o) * pi
        a2 = a * a
        s, c = splat16(sine[sine.size - 1]), splat16(cosine[cosine.size - 1])
        for d in range(sine.size - 2, -1, -1):
            s, c = s * a2 + splat16(sine[d]), c * a2 + splat16(cosine[d])
        s = s * a
        g = load16(gain, o)
        two = splat16(fraction.dtype.type(2.0)) * s * g
        store(gain, o, g - two * s)
        store(phase, o, two * c)
    return count


def _pair(load: Any, splat: Any) -> tuple[Any, Any]:
    """Gather and spread for groups of as many modes as ``load`` has lanes."""

    def gather(
        x: Any, xo: int, length: int, h: Any, size: int, lane: int, count: int, width: int, index: Any, phase: Any,
        gain: Any, taps: Any, pitch: int,
    ) -> None:  # fmt: skip
        zero = splat(x.dtype.type(0.0))
        for l in range(count):  # noqa: E741
            i = xo + index[l] * 32 + lane
            j = xo + (length - index[l]) * 32 + lane
            ar, ai, br, bi = zero, zero, zero, zero
            for t in range(width):
                w = splat(taps[t * pitch + l])
                ar = ar + w * load(x, i)
                ai = ai + w * load(x, i + 16)
                br = br + w * load(x, j)
                bi = bi + w * load(x, j + 16)
                i += 32
                j -= 32
            c, s = splat(gain[l]), splat(phase[l])
            real = (ar + br) * c + (ai - bi) * s
            imaginary = (ai + bi) * c + (br - ar) * s
            store(h, l * 32 + lane, real)
            store(h, l * 32 + lane + 16, imaginary)
            if l > 0:
                o = (size - l) * 32 + lane
                store(h, o, real)
                store(h, o + 16, imaginary)
        for l in range(count, size - max(count, 1) + 1):  # noqa: E741
            store(h, l * 32 + lane, zero)
            store(h, l * 32 + lane + 16, zero)

    def spread(
        h: Any, size: int, lane: int, count: int, x: Any, xo: int, length: int, width: int, index: Any, phase: Any,
        gain: Any, taps: Any, pitch: int,
    ) -> None:  # fmt: skip
        for l in range(count):  # noqa: E741
            real, imaginary = load(h, l * 32 + lane), load(h, l * 32 + lane + 16)
            if l > 0:
                o = (size - l) * 32 + lane
                real, imaginary = real + load(h, o), imaginary + load(h, o + 16)
            c, s = splat(gain[l]), splat(phase[l])
            ar, ai = real * c - imaginary * s, imaginary * c + real * s
            br, bi = real * c + imaginary * s, imaginary * c - real * s
            i = xo + index[l] * 32 + lane
            j = xo + (length - index[l]) * 32 + lane
            for t in range(width):
                w = splat(taps[t * pitch + l])
                store(x, i, load(x, i) + w * ar)
                store(x, i + 16, load(x, i + 16) + w * ai)
                store(x, j, load(x, j) + w * br)
                store(x, j + 16, load(x, j + 16) + w * bi)
                i += 32
                j -= 32

    return compiled(gather, kept=False), compiled(spread, kept=False)


_gather4, _spread4 = _pair(load4, splat4)
_gather2, _spread2 = _pair(load2, splat2)
_gather1, _spread1 = _pair(load1, splat1)


@compiled
def to_depth(
    first: int, last: int, source: Any, source_rows: Any, source_imaginary: Any, factors: Any, squares: Any,
    target: Any, target_rows: Any, target_imaginary: Any, samples: int, centre: int, length: int, window: Any,
    size: int, band: float, ratio: float, turns: float, table: Any, steps: Any, taps_of: Any, sine: Any, cosine: Any,
    depth_first: int, depth_count: int, ones: Any, unit: Any, ft: Any, fz: Any, flag: Any,
    a: Any, b: Any, index: Any, fraction: Any, phase: Any, gain: Any, taps: Any, tmp: Any,
) -> None:  # fmt: skip
    """Blocks ``first`` … ``last`` of 16 columns: the transpose of :func:`to_time`."""
    pitch, width = fraction.size, taps_of.shape[0]
    xo, lanes = np.int64(PAD * 32), 16 // squares.shape[1]
    zero, one = np.int64(0), np.int64(1)
    for block in range(first, last):
        if flag[0]:
            return
        _bring(
            source, source_rows[block], source_imaginary[block], samples, centre, length, window, factors[block],
            a, xo, tmp,
        )  # fmt: skip
        flip = fft(a, xo, b, xo, zero, length, ft[0], ft[1], ft[2], ft[3], ft[4], tmp)
        x, h = (b, a) if flip else (a, b)
        for o in range(0, PAD * 32, 16):
            store(x, o, load16(x, length * 32 + o))
            store(x, xo + length * 32 + o, load16(x, xo + o))
        for group in range(squares.shape[1]):
            count = _stencils(
                squares[block, group], band, ratio, turns, table, steps, width, taps_of, sine, cosine, index, fraction,
                phase, gain, taps, pitch,
            )  # fmt: skip
            lane = lanes * group
            if lanes == 4:
                _gather4(x, xo, length, h, size, lane, count, width, index, phase, gain, taps, pitch)
            elif lanes == 2:
                _gather2(x, xo, length, h, size, lane, count, width, index, phase, gain, taps, pitch)
            else:
                _gather1(x, xo, length, h, size, lane, count, width, index, phase, gain, taps, pitch)
        result = x if fft(h, zero, x, zero, one, size, fz[0], fz[1], fz[2], fz[3], fz[4], tmp) else h
        _take(
            result, zero, depth_count, -depth_first, size, ones, unit, target, target_rows[block],
            target_imaginary[block], tmp,
        )  # fmt: skip


@compiled
def to_time(
    first: int, last: int, source: Any, source_rows: Any, source_imaginary: Any, factors: Any, squares: Any,
    target: Any, target_rows: Any, target_imaginary: Any, samples: int, centre: int, length: int, window: Any,
    size: int, band: float, ratio: float, turns: float, table: Any, steps: Any, taps_of: Any, sine: Any, cosine: Any,
    depth_first: int, depth_count: int, ones: Any, unit: Any, ft: Any, fz: Any, flag: Any,
    a: Any, b: Any, index: Any, fraction: Any, phase: Any, gain: Any, taps: Any, tmp: Any,
) -> None:  # fmt: skip
    """Blocks ``first`` … ``last`` of 16 columns from ``source`` (depth) to ``target`` (time)."""
    pitch, width = fraction.size, taps_of.shape[0]
    xo, lanes = np.int64(PAD * 32), 16 // squares.shape[1]
    zero, one = np.int64(0), np.int64(1)
    for block in range(first, last):
        if flag[0]:
            return
        _bring(
            source, source_rows[block], source_imaginary[block], depth_count, -depth_first, size, ones, unit,
            a, zero, tmp,
        )  # fmt: skip
        flip = fft(a, zero, b, zero, zero, size, fz[0], fz[1], fz[2], fz[3], fz[4], tmp)
        h, x = (b, a) if flip else (a, b)
        for o in range(0, (length + 2 * PAD) * 32, 16):
            store(x, o, splat16(x.dtype.type(0.0)))
        for group in range(squares.shape[1]):
            count = _stencils(
                squares[block, group], band, ratio, turns, table, steps, width, taps_of, sine, cosine, index, fraction,
                phase, gain, taps, pitch,
            )  # fmt: skip
            lane = lanes * group
            if lanes == 4:
                _spread4(h, size, lane, count, x, xo, length, width, index, phase, gain, taps, pitch)
            elif lanes == 2:
                _spread2(h, size, lane, count, x, xo, length, width, index, phase, gain, taps, pitch)
            else:
                _spread1(h, size, lane, count, x, xo, length, width, index, phase, gain, taps, pitch)
        for o in range(0, PAD * 32, 16):
            i = xo + (length - PAD) * 32 + o
            store(x, i, load16(x, i) + load16(x, o))
            store(x, xo + o, load16(x, xo + o) + load16(x, xo + length * 32 + o))
        result = h if fft(x, xo, h, xo, one, length, ft[0], ft[1], ft[2], ft[3], ft[4], tmp) else x
        _take(
            result, xo, samples, centre, length, window, factors[block], target, target_rows[block],
            target_imaginary[block], tmp,
        )  # fmt: skip
