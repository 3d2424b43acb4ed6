"""Bilinear lookup of the response table inside kernels, as a plain function and compiled for the CPU."""

from __future__ import annotations

import math
from typing import Any

from steradian.core.jit import jit_inline


def lookup(table: Any, steps: Any, square: float, kappa: float) -> tuple[float, float]:
    """Interpolate the response bilinearly at κ and the angle with sine |j|/κ: amplitude, and phase in turns.

    ``table`` has shape (2, frequencies, sines), ``steps`` the rows a unit of κ and the columns a unit of sine. The CUDA
    kernels compile the same function.
    """
    u = min(kappa * steps[0], table.shape[1] - 1.000001)
    sine = math.sqrt(square) / kappa if kappa > 0 else 0.0
    v = min(sine * steps[1], table.shape[2] - 1.000001)
    i, k = int(u), int(v)
    a, b = u - i, v - k
    low = table[0, i, k] * (1 - b) + table[0, i, k + 1] * b
    high = table[0, i + 1, k] * (1 - b) + table[0, i + 1, k + 1] * b
    low_turn = table[1, i, k] * (1 - b) + table[1, i, k + 1] * b
    high_turn = table[1, i + 1, k] * (1 - b) + table[1, i + 1, k + 1] * b
    return low * (1 - a) + high * a, low_turn * (1 - a) + high_turn * a


interpolate_response: Any = jit_inline(lookup)
