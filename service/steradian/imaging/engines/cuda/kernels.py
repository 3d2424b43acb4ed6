"""CUDA kernels, compiled at their first launch; each element of a result is summed by one thread.

No thread adds to what another one writes, so results are the same bits in every run. Every kernel walks over its
numbers with the stride of its threads: it is right for any number of them, also for the few of Numba's simulator.
"""

from __future__ import annotations

import importlib
import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from steradian.imaging.engines.numba.response_interpolation import lookup

cuda: Any = importlib.import_module("numba.cuda")  # numba-cuda's, or Numba's simulator
_FLOOR = 64
"""More than half of the widest window: what is above −64 is rounded down by cutting off after adding it."""


class Kernels(NamedTuple):
    """Compiled CUDA kernels of one floating-point precision."""

    combine: Any
    decimate: Any
    to_depth: Any
    weigh: Any
    to_time: Any


@cuda.jit(device=True)
def stencil_position(kappa: float, rule: Any) -> tuple[int, float]:
    """Return the first frequency of the interpolation stencil at κ, and the fractional position, in −1 … 1."""
    u = kappa * rule.ratio
    left = u - 0.5 * rule.taps.shape[0]
    whole = int(left + _FLOOR) - _FLOOR
    cell = int(u + 0.5) if rule.nearest else whole + 1
    return cell - rule.lowest, 2.0 * (left - whole) - 1.0


interpolate_response = cuda.jit(device=True)(lookup)


@cuda.jit(device=True)
def gain_and_phase(l: int, kappa: float, square: float, rule: Any) -> tuple[float, float]:  # noqa: E741
    """Return amplitude and phase (in turns, −½ … ½) of the factor at κ."""
    gain = 0.5
    if not rule.both:
        gain = 2.0 * l / kappa if kappa > 0 else 2.0
    turn = -rule.turns * kappa
    if rule.table.shape[1] > 1:
        amplitude, more = interpolate_response(rule.table, rule.steps, square, kappa)
        gain *= amplitude
        turn += more
    if rule.overlying.shape[0] > 0:
        turn -= rule.shift * l
        for i in range(rule.overlying.shape[0]):
            root = rule.overlying[i, 0] * kappa * kappa - rule.overlying[i, 1] * square
            if root > 0:
                turn += math.sqrt(root)
            else:
                gain = 0.0
    return gain, turn - math.floor(turn + 0.5)


@lru_cache(maxsize=2)
def kernels(dtype: str) -> Kernels:
    """Compile the kernels of one precision, because constants of another would cause float64 arithmetic (cached)."""
    real = np.float32 if dtype == "float32" else np.float64
    zero, half, circle = real(0), real(0.5), real(2 * np.pi)

    @cuda.jit(device=True)
    def tap(taps: Any, t: int, y: Any) -> Any:
        value = taps[t, taps.shape[1] - 1]
        for d in range(taps.shape[1] - 2, -1, -1):
            value = value * y + taps[t, d]
        return value

    @cuda.jit(device=True)
    def factor(l: int, kappa: float, square: float, rule: Any) -> tuple[Any, Any]:  # noqa: E741
        gain, turn = gain_and_phase(l, kappa, square, rule)
        amplitude, angle = real(gain), circle * real(turn)
        return amplitude * real(math.cos(angle)), amplitude * real(math.sin(angle))

    @cuda.jit(device=True)
    def times(fr: Any, fi: Any, g: Any, h: Any) -> tuple[Any, Any]:
        """Return the product of a complex factor and two lateral factors."""
        r, i = g.real * h.real - g.imag * h.imag, g.real * h.imag + g.imag * h.real
        return fr * r - fi * i, fr * i + fi * r

    @cuda.jit
    def combine(values: Any, matrix: Any, result: Any) -> None:
        """Compute a sparse matrix product: result[r, f] = Σ weights[e]·values[columns[e], f]."""
        x, y = cuda.grid(2)
        across, down = cuda.gridsize(2)
        for r in range(y, result.shape[0], down):
            for f in range(x, result.shape[1], across):
                re, im = zero, zero
                for e in range(matrix.starts[r], matrix.starts[r + 1]):
                    w, v = matrix.weights[e], values[matrix.columns[e], f]
                    re += w * v.real
                    im += w * v.imag
                result[r, f] = complex(re, im)

    @cuda.jit
    def decimate(lines: Any, matrix: Any, result: Any) -> None:
        """Resample A-lines: result[m, n] = Σ taps[n, t]·lines[m, starts[n] + t]."""
        x, y = cuda.grid(2)
        across, down = cuda.gridsize(2)
        for m in range(y, result.shape[0], down):
            for n in range(x, result.shape[1], across):
                start, sum_ = matrix.starts[n], zero
                for t in range(matrix.taps.shape[1]):
                    sum_ += matrix.taps[n, t] * lines[m, start + t]
                result[m, n] = sum_

    @cuda.jit
    def to_depth(modes: Any, orbits: Any, rule: Any, result: Any) -> None:
        """Interpolate at κ (paper, NER-NUFFT, equation 5), times factor and lateral factor; l from 0 only."""
        x, y = cuda.grid(2)
        across, down = cuda.gridsize(2)
        width = len(orbits.squares_y)
        for orbit in range(y, len(orbits.squares_x) * width, down):
            a = orbit // width
            b = orbit - a * width
            square = orbits.squares_x[a] + orbits.squares_y[b]
            p1, p2, q1, q2 = orbits.lines_x[a, 0], orbits.lines_x[a, 1], orbits.lines_y[b, 0], orbits.lines_y[b, 1]
            i1, i2, k1, k2 = orbits.lines_x[a, 2], orbits.lines_x[a, 3], orbits.lines_y[b, 2], orbits.lines_y[b, 3]
            for l in range(x, result.shape[2], across):  # noqa: E741
                kappa = math.sqrt(float(l) * float(l) + square)
                r1, s1, r2, s2, r3, s3, r4, s4 = zero, zero, zero, zero, zero, zero, zero, zero
                if kappa < rule.band and l < rule.depths:
                    cell, between = stencil_position(kappa, rule)
                    fraction = real(between)
                    for t in range(rule.taps.shape[0]):
                        w = tap(rule.taps, t, fraction)
                        v1, v2 = modes[p1, q1, cell + t], modes[p1, q2, cell + t]
                        v3, v4 = modes[p2, q1, cell + t], modes[p2, q2, cell + t]
                        r1 += w * v1.real
                        s1 += w * v1.imag
                        r2 += w * v2.real
                        s2 += w * v2.imag
                        r3 += w * v3.real
                        s3 += w * v3.imag
                        r4 += w * v4.real
                        s4 += w * v4.imag
                    fr, fi = factor(l, kappa, square, rule)
                    gr, gi = times(fr, fi, orbits.factors_x[a, 0], orbits.factors_y[b, 0])
                    r1, s1 = gr * r1 - gi * s1, gr * s1 + gi * r1
                    gr, gi = times(fr, fi, orbits.factors_x[a, 0], orbits.factors_y[b, 1])
                    r2, s2 = gr * r2 - gi * s2, gr * s2 + gi * r2
                    gr, gi = times(fr, fi, orbits.factors_x[a, 1], orbits.factors_y[b, 0])
                    r3, s3 = gr * r3 - gi * s3, gr * s3 + gi * r3
                    gr, gi = times(fr, fi, orbits.factors_x[a, 1], orbits.factors_y[b, 1])
                    r4, s4 = gr * r4 - gi * s4, gr * s4 + gi * r4
                    if rule.both:  # that of −κ is the conjugate of the opposite mode's
                        r1, s1 = r1 + r4, s1 - s4
                        r2, s2 = r2 + r3, s2 - s3
                        r4, s4, r3, s3 = r1, -s1, r2, -s2
                result[i1, k1, l] = complex(r1, s1)
                result[i1, k2, l] = complex(r2, s2)
                result[i2, k1, l] = complex(r3, s3)
                result[i2, k2, l] = complex(r4, s4)

    @cuda.jit
    def weigh(modes: Any, orbits: Any, rule: Any) -> None:
        """Multiply modes over depth in place by the conjugate factors, adding those of l and −l (adjoint)."""
        x, y = cuda.grid(2)
        across, down = cuda.gridsize(2)
        width = len(orbits.squares_y)
        for orbit in range(y, len(orbits.squares_x) * width, down):
            a = orbit // width
            b = orbit - a * width
            square = orbits.squares_x[a] + orbits.squares_y[b]
            i1, i2, k1, k2 = orbits.lines_x[a, 2], orbits.lines_x[a, 3], orbits.lines_y[b, 2], orbits.lines_y[b, 3]
            for l in range(x, modes.shape[2], across):  # noqa: E741
                kappa = math.sqrt(float(l) * float(l) + square)
                fr, fi = zero, zero
                if kappa < rule.band and l < rule.depths:
                    fr, fi = factor(l, kappa, square, rule)
                v1, v2, v3, v4 = modes[i1, k1, l], modes[i1, k2, l], modes[i2, k1, l], modes[i2, k2, l]
                r1, s1, r2, s2 = v1.real, v1.imag, v2.real, v2.imag
                r3, s3, r4, s4 = v3.real, v3.imag, v4.real, v4.imag
                if rule.both and l > 0:  # that of −l is the conjugate of the opposite mode's
                    r1, s1, r2, s2 = r1 + r4, s1 - s4, r2 + r3, s2 - s3
                    r4, s4, r3, s3 = r1, -s1, r2, -s2
                if not rule.both and l == 0:  # there is no −l, whose conjugate the sensors' real part adds
                    fr, fi = half * fr, half * fi
                gr, gi = times(fr, fi, orbits.factors_x[a, 0], orbits.factors_y[b, 0])
                modes[i1, k1, l] = complex(gr * r1 + gi * s1, gr * s1 - gi * r1)
                gr, gi = times(fr, fi, orbits.factors_x[a, 0], orbits.factors_y[b, 1])
                modes[i1, k2, l] = complex(gr * r2 + gi * s2, gr * s2 - gi * r2)
                gr, gi = times(fr, fi, orbits.factors_x[a, 1], orbits.factors_y[b, 0])
                modes[i2, k1, l] = complex(gr * r3 + gi * s3, gr * s3 - gi * r3)
                gr, gi = times(fr, fi, orbits.factors_x[a, 1], orbits.factors_y[b, 1])
                modes[i2, k2, l] = complex(gr * r4 + gi * s4, gr * s4 - gi * r4)

    @cuda.jit
    def to_time(modes: Any, orbits: Any, rule: Any, result: Any) -> None:
        """Spread modes over depth to time frequencies: the adjoint of the interpolation at κ."""
        x, y = cuda.grid(2)
        across, down = cuda.gridsize(2)
        width, reach = len(orbits.squares_y), rule.taps.shape[0]
        for orbit in range(y, len(orbits.squares_x) * width, down):
            a = orbit // width
            b = orbit - a * width
            square = orbits.squares_x[a] + orbits.squares_y[b]
            p1, p2, q1, q2 = orbits.lines_x[a, 0], orbits.lines_x[a, 1], orbits.lines_y[b, 0], orbits.lines_y[b, 1]
            i1, i2, k1, k2 = orbits.lines_x[a, 2], orbits.lines_x[a, 3], orbits.lines_y[b, 2], orbits.lines_y[b, 3]
            for f in range(x, result.shape[2], across):
                r1, s1, r2, s2, r3, s3, r4, s4 = zero, zero, zero, zero, zero, zero, zero, zero
                # the first and the last such l, and one more on either side: the stencil tells what is so
                low = max(0.0, (f + rule.lowest - 0.5 * reach) / rule.ratio)
                high = max(0.0, (f + rule.lowest + 0.5 * reach) / rule.ratio)
                first = max(0, int(math.sqrt(max(0.0, low * low - square))) - 1)
                last = min(rule.depths, int(math.sqrt(max(0.0, high * high - square))) + 3)
                if high * high < square:
                    last = 0
                for l in range(first, last):  # noqa: E741
                    kappa = math.sqrt(float(l) * float(l) + square)
                    if kappa >= rule.band:
                        break
                    cell, between = stencil_position(kappa, rule)
                    t = f - cell
                    if t < 0 or t >= reach:
                        continue
                    w = tap(rule.taps, t, real(between))
                    v1, v2, v3, v4 = modes[i1, k1, l], modes[i1, k2, l], modes[i2, k1, l], modes[i2, k2, l]
                    r1 += w * v1.real
                    s1 += w * v1.imag
                    r2 += w * v2.real
                    s2 += w * v2.imag
                    r3 += w * v3.real
                    s3 += w * v3.imag
                    r4 += w * v4.real
                    s4 += w * v4.imag
                result[p1, q1, f] = complex(r1, s1)
                result[p1, q2, f] = complex(r2, s2)
                result[p2, q1, f] = complex(r3, s3)
                result[p2, q2, f] = complex(r4, s4)

    return Kernels(combine, decimate, to_depth, weigh, to_time)
