"""Compiled factor of the extrapolation through layers, and its application to lateral modes over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from steradian.core.jit import jit


@jit
def transfer(squares: Any, s: Any, path: Any, shift: Any, result: Any) -> None:
    """Compute result[u, f] = shift[f]·H(s[f], √squares[u]) (:mod:`steradian.imaging.transforms.extrapolation`)."""
    layers = path.shape[1]
    for u in range(squares.size):
        for f in range(s.size):
            exponent, gained, above = complex(0.0), shift[f], complex(0.0)
            for i in range(layers):
                slowness = s[f] / path[0, i]
                gamma = np.sqrt(slowness * slowness + squares[u])
                exponent -= gamma * path[1, i]
                if i > 0:
                    passed = path[2, i - 1] * gamma
                    gained *= 2 * passed / (passed + path[2, i] * above)
                above = gamma
            result[u, f] = gained * np.exp(exponent)
