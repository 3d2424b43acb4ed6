"""Compiled kernels of :mod:`steradian.phantoms.forward` and :mod:`steradian.phantoms.waves_2d`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.jit import jit

Array = NDArray[np.float64]


def _add_balls(
    positions: Array,
    centres: Array,
    sigmas: Array,
    amplitudes: Array,
    start: float,
    step: float,
    window: float,
    table: Array,
    line: Array,
    traces: NDArray[np.float32],
) -> None:
    """Add the balls' pressure to traces (P, N_t); lengths in m, ``start`` and ``step`` being c·t₀ and c·dt.

    From one sample to the next exp(−u²/2s²) is multiplied by a factor that itself is multiplied by a constant.
    """
    samples = traces.shape[1]
    for m in range(positions.shape[0]):
        line[:] = 0.0
        for b in range(sigmas.shape[0]):
            dx, dy, dz = positions[m, 0] - centres[b, 0], positions[m, 1] - centres[b, 1], centres[b, 2]
            s = sigmas[b]
            r = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-6 * s)
            place = abs(dz) / r * (table.shape[0] - 1)
            node = min(int(place), table.shape[0] - 2)
            gain = table[node] + (place - node) * (table[node + 1] - table[node])
            a = amplitudes[b] * gain / (2.0 * r)
            half = 1.0 / (2.0 * s * s)
            first = max(0, math.ceil((r - window * s - start) / step))
            last = min(samples - 1, math.floor((r + window * s - start) / step))
            u = r - start - first * step
            value = a * math.exp(-u * u * half)
            factor = math.exp((2.0 * u - step) * step * half)
            constant = math.exp(-2.0 * step * step * half)
            for n in range(first, last + 1):
                line[n] += u * value
                value *= factor
                factor *= constant
                u -= step
            if r - start < window * s or r + start < window * s:  # the wave that has passed the ball's middle
                for n in range(samples):
                    v = r + start + n * step
                    if v > window * s:
                        break
                    line[n] += a * v * math.exp(-v * v * half)
        for n in range(samples):
            traces[m, n] += line[n]


add_balls: Any = jit(_add_balls)


def _oscillate(turns: Array, real: Array, imaginary: Array, state: Array, sums: NDArray[np.complex128]) -> None:
    """Add plane waves to sums: sums[n, x] = Σ_k (real + i·imaginary)[x, k]·cos((m + n)·angle[x, k]).

    ``turns`` holds 2·cos(angle) and ``state`` (2, X, K) the cosines at steps m and m − 1; it is left at the next ones.
    """
    for x in range(turns.shape[0]):
        for n in range(sums.shape[0]):
            a, b = 0.0, 0.0
            for k in range(turns.shape[1]):
                cosine = state[0, x, k]
                a += real[x, k] * cosine
                b += imaginary[x, k] * cosine
                state[0, x, k] = turns[x, k] * cosine - state[1, x, k]
                state[1, x, k] = cosine
            sums[n, x] = complex(a, b)


oscillate: Any = jit(_oscillate)
