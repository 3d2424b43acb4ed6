"""Time to depth for 16 lateral modes at once (compiled).

Per mode: window and transform over time, interpolation at κ (paper, NER-NUFFT, equation 5), the factor 2l/κ, inverse
transform over depth; all within the processor's second cache. Four modes (two, if κ grows
differently along x and y; one in 2-D) with the same |j|² share one stencil.
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
PIECE = 64  # values of l interpolated for all groups of a block in turn: what they read then stays in the first cache


@compiled
def _load(
    source: Any, rows: Any, imaginary: Any, samples: int, centre: int, length: int, window: Any, factors: Any,
    x: Any, xo: int, tmp: Any,
) -> None:  # fmt: skip
    """Bring samples n of 16 columns, times window and a complex factor a column, at cell (n − centre) mod length."""
    rr, ri, ir, ii = load16(factors, 0), load16(factors, 16), load16(factors, 32), load16(factors, 48)
    for start in range(0, samples, 16):
        count = min(16, samples - start)
        if count == 16:
            collect(source, rows, start, tmp, 0)
            collect(source, imaginary, start, tmp, 16)
        else:
            for lane in range(16):
                for n in range(count):
                    tmp[n * 32 + lane] = source[rows[lane] + start + n]
                    tmp[n * 32 + 16 + lane] = source[imaginary[lane] + start + n]
        for n in range(count):
            w = splat16(window[start + n])
            a, b = load16(tmp, n * 32) * w, load16(tmp, n * 32 + 16) * w
            cell = start + n - centre
            o = xo + (cell if cell >= 0 else cell + length) * 32
            store(x, o, a * rr + b * ri)
            store(x, o + 16, a * ir + b * ii)
    for o in range(xo + (samples - centre) * 32, xo + (length - centre) * 32):
        x[o] = 0


@compiled
def _reach(square: float, band: float) -> int:
    """Count the l with κ < band."""
    return int(np.ceil(np.sqrt(band * band - square))) if square < band * band else 0


@compiled
def _stencils(
    square: float, first: int, count: int, ratio: float, turns: float, table: Any, steps: Any, width: int, nearest: int,
    taps_of: Any, sine: Any, cosine: Any, index: Any, fraction: Any, phase: Any, gain: Any, taps: Any,
) -> None:  # fmt: skip
    """First grid points, taps and factors (2l/κ)·e^{−2πi·turns·κ} of ``count`` ≤ PIECE values of l from ``first``.

    A filter, if ``table`` has more than one entry, is part of the factors.
    """
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
        gain[n] = 2.0 * l / kappa if kappa > 0 else 2.0
    if table.shape[1] > 1:
        for n in range(count):
            kappa = np.sqrt(float(first + n) * float(first + n) + square)
            amplitude, turn = look_up(table, steps, square, kappa)
            gain[n] *= amplitude
            phase[n] -= turn + np.rint(phase[n] - turn)
    degree = taps_of.shape[1] - 1
    pi = splat16(fraction.dtype.type(np.pi))
    for o in range(0, count, 16):
        y = load16(fraction, o)
        for t in range(width):
            value = splat16(taps_of[t, degree])
            for d in range(degree - 1, -1, -1):
                value = value * y + splat16(taps_of[t, d])
            store(taps, t * PIECE + o, value)
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


def _gather_of(load: Any, splat: Any) -> Any:
    """Make the interpolation for groups of as many modes as ``load`` takes lanes."""

    def gather(
        x: Any, xo: int, length: int, h: Any, size: int, lane: int, first: int, count: int, width: int, index: Any,
        phase: Any, gain: Any, taps: Any,
    ) -> None:  # fmt: skip
        """H(±l) of a group, ``count`` values of l; gain and phase are the factor's real and minus imaginary part."""
        zero = splat(x.dtype.type(0.0))
        for n in range(count):
            i = xo + index[n] * 32 + lane
            j = xo + (length - index[n]) * 32 + lane
            ar, ai, br, bi = zero, zero, zero, zero
            for t in range(width):
                w = splat(taps[t * PIECE + n])
                ar = ar + w * load(x, i)
                ai = ai + w * load(x, i + 16)
                br = br + w * load(x, j)
                bi = bi + w * load(x, j + 16)
                i += 32
                j -= 32
            c, s = splat(gain[n]), splat(phase[n])
            l = first + n  # noqa: E741
            store(h, l * 32 + lane, ar * c + ai * s)
            store(h, l * 32 + lane + 16, ai * c - ar * s)
            if l > 0:
                o = (size - l) * 32 + lane
                store(h, o, br * c - bi * s)
                store(h, o + 16, bi * c + br * s)

    return compiled(gather, kept=False)


_gather4, _gather2, _gather1 = _gather_of(load4, splat4), _gather_of(load2, splat2), _gather_of(load1, splat1)


@compiled
def columns(
    first: int, last: int, source: Any, source_rows: Any, source_imaginary: Any, factors: Any, squares: Any, edges: Any,
    target: Any, target_rows: Any, target_imaginary: Any, samples: int, centre: int, length: int, window: Any,
    size: int, ratio: float, turns: float, table: Any, steps: Any, width: int, nearest: int, taps_of: Any, sine: Any,
    cosine: Any, depth_first: int, depth_count: int, ft: Any, fz: Any, flag: Any,
    a: Any, b: Any, index: Any, fraction: Any, phase: Any, gain: Any, taps: Any, tmp: Any,
) -> None:  # fmt: skip
    """Blocks ``first`` … ``last`` of 16 columns from ``source`` (time) to ``target`` (depth)."""
    xo, lanes = np.int64(PAD * 32), 16 // squares.shape[1]
    zero, one = np.int64(0), np.int64(1)
    nothing = splat16(a.dtype.type(0.0))
    for block in range(first, last):
        if flag[0]:
            return
        _load(
            source, source_rows[block], source_imaginary[block], samples, centre, length, window, factors[block],
            a, xo, tmp,
        )  # fmt: skip
        flip = fft(a, xo, b, xo, zero, length, ft[0], ft[1], ft[2], ft[3], ft[4], tmp)
        x, h = (b, a) if flip else (a, b)
        for o in range(0, PAD * 32, 16):
            store(x, o, load16(x, length * 32 + o))
            store(x, xo + length * 32 + o, load16(x, xo + o))
        low, high = size, 0
        for group in range(squares.shape[1]):
            reach = _reach(squares[block, group], 0.5 * size)
            low, high = min(low, reach), max(high, reach)
        for o in range(low * 32, (size - max(low, 1) + 1) * 32, 16):
            store(h, o, nothing)
        for start in range(0, high, PIECE):
            for group in range(squares.shape[1]):
                square, lane = squares[block, group], lanes * group
                count = min(PIECE, _reach(square, 0.5 * size) - start)
                if count <= 0:
                    continue
                _stencils(
                    square, start, count, ratio, turns, table, steps, width, nearest, taps_of, sine, cosine, index,
                    fraction, phase, gain, taps,
                )  # fmt: skip
                if lanes == 4:
                    _gather4(x, xo, length, h, size, lane, start, count, width, index, phase, gain, taps)
                elif lanes == 2:
                    _gather2(x, xo, length, h, size, lane, start, count, width, index, phase, gain, taps)
                else:
                    _gather1(x, xo, length, h, size, lane, start, count, width, index, phase, gain, taps)
                if edges[block, group]:
                    for l in range(max(start, 1), start + count):  # noqa: E741
                        for e in range(lane - lane % 2, lane + lanes, 2):
                            o = (size - l) * 32 + e
                            h[o] = h[o + 1]
                            h[o + 16] = h[o + 17]
        result = x if fft(h, zero, x, zero, one, size, fz[0], fz[1], fz[2], fz[3], fz[4], tmp) else h
        for z in range(0, depth_count, 16):
            count = min(16, depth_count - z)
            o = (depth_first + z) * 32
            if count == 16:
                distribute(result, o, target, target_rows[block], z)
                distribute(result, o + 16, target, target_imaginary[block], z)
            else:
                for lane in range(16):
                    for n in range(count):
                        target[target_rows[block, lane] + z + n] = result[o + n * 32 + lane]
                        target[target_imaginary[block, lane] + z + n] = result[o + n * 32 + 16 + lane]
