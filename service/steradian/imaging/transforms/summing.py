"""Weighted sums of samples (compiled)."""

from __future__ import annotations

from typing import Any

from steradian.compiled import compiled


@compiled
def weighted_sums(lines: Any, starts: Any, taps: Any, result: Any) -> None:
    """Σ_t taps[n, t]·lines[m, starts[n] + t] to result[m, n]."""
    for m in range(lines.shape[0]):
        line = lines[m]
        for n in range(starts.size):
            row = taps[n]
            part = line[starts[n] : starts[n] + row.size]  # views with indices from 0: else LLVM does not vectorise
            total = line.dtype.type(0)
            for t in range(row.size):
                total += row[t] * part[t]
            result[m, n] = total
