"""Compiled factor of the extrapolation through layers, and its application to lateral modes over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from steradian.core.jit import jit


@jit
def transfer(squares: Any, slowness: Any, path: Any, shift: Any, result: Any) -> None:
    """Compute result[u, f] = shift[f]·H(s[f], √squares[u]) (:mod:`steradian.imaging.transforms.extrapolation`)."""
    for u in range(squares.size):
        for f in range(shift.size):
            exponent, gained, above = complex(0.0), shift[f], complex(0.0)
            for i in range(path.shape[1]):
                gamma = np.sqrt(slowness[i, f] * slowness[i, f] + squares[u])
                exponent -= gamma * path[0, i]
                if i > 0:
                    passed = path[1, i - 1] * gamma
                    gained *= 2 * passed / (passed + path[1, i] * above)
                above = gamma
            result[u, f] = gained * np.exp(exponent)
