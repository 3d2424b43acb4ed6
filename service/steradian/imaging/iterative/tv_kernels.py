"""Compiled kernels of the total-variation proximal operator."""

from __future__ import annotations

from typing import Any

import numpy as np

from steradian.core.jit import jit


@jit
def primal_step(u: Any, dual: Any, x: Any, first: int, last: int, length: Any, rates: Any, low: Any) -> None:
    """Compute x = max(low, u − length·Dᵀ dual) in rows ``first`` … ``last``; D: forward differences times ``rates``."""
    ny, nz = u.shape[1], u.shape[2]
    a, b, c = length * rates[0], length * rates[1], length * rates[2]
    for i in range(first, last):
        for j in range(ny):
            for k in range(nz):
                v = u[i, j, k] + a * dual[0, i, j, k] + b * dual[1, i, j, k] + c * dual[2, i, j, k]
                x[i, j, k] = v
            if i > 0:
                for k in range(nz):
                    x[i, j, k] -= a * dual[0, i - 1, j, k]
            if j > 0:
                for k in range(nz):
                    x[i, j, k] -= b * dual[1, i, j - 1, k]
            for k in range(1, nz):
                x[i, j, k] -= c * dual[2, i, j, k - 1]
            for k in range(nz):
                x[i, j, k] = max(low, x[i, j, k])


@jit
def dual_step(x: Any, dual: Any, first: int, last: int, rate: Any, rates: Any) -> None:
    """Project dual + rate·D x onto vectors of norm ≤ 1, in rows ``first`` … ``last``."""
    nx, ny, nz = x.shape
    one = x.dtype.type(1)
    a, b, c = rate * rates[0], rate * rates[1], rate * rates[2]
    for i in range(first, last):
        for j in range(ny):
            right, up = min(i + 1, nx - 1), min(j + 1, ny - 1)
            for k in range(nz - 1):
                v = x[i, j, k]
                p = dual[0, i, j, k] + a * (x[right, j, k] - v)
                q = dual[1, i, j, k] + b * (x[i, up, k] - v)
                r = dual[2, i, j, k] + c * (x[i, j, k + 1] - v)
                shrink = one / max(one, np.sqrt(p * p + q * q + r * r))
                dual[0, i, j, k] = p * shrink
                dual[1, i, j, k] = q * shrink
                dual[2, i, j, k] = r * shrink
            k = nz - 1
            v = x[i, j, k]
            p = dual[0, i, j, k] + a * (x[right, j, k] - v)
            q = dual[1, i, j, k] + b * (x[i, up, k] - v)
            shrink = one / max(one, np.sqrt(p * p + q * q))
            dual[0, i, j, k] = p * shrink
            dual[1, i, j, k] = q * shrink
