"""Round numbers along an axis."""

from __future__ import annotations

from math import ceil, floor, log10

MOST = 8


def ticks(first: float, last: float, most: int = MOST) -> list[float]:
    """Round numbers from first to last, at most about ``most``; none where no round number lies between them."""
    raw = (last - first) / most
    power = 10.0 ** floor(log10(raw))
    step = next(step for step in (power, 2 * power, 5 * power, 10 * power) if step >= raw * (1 - 1e-9))
    numbers = range(ceil(first / step - 1e-6), floor(last / step + 1e-6) + 1)
    return [float(f"{number * step:.12g}") for number in numbers]
