"""Compiled weighted sums of samples."""

from __future__ import annotations

from typing import Any

from steradian.core.jit import jit


@jit
def weighted_sums(lines: Any, starts: Any, taps: Any, result: Any) -> None:
    """Compute result[m, n] = Σ_t taps[n, t]·lines[m, starts[n] + t]."""
    width, last, nothing = taps.shape[1], lines.shape[0] - 1, lines.dtype.type(0)
    for m in range(0, last + 1, 2):  # two lines for each time that the taps are read; an odd one as both
        o = min(m + 1, last)
        for n in range(starts.size):
            # views, with indices from 0: else LLVM does not vectorise
            row, a, b = taps[n], lines[m, starts[n] : starts[n] + width], lines[o, starts[n] : starts[n] + width]
            u, v = nothing, nothing
            for t in range(width):
                u += row[t] * a[t]
                v += row[t] * b[t]
            result[m, n], result[o, n] = u, v
