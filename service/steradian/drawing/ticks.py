"""Plot axes and their tick positions at round numbers."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, log10

from steradian.drawing.style import GAP, TICK, font, format_number

MOST = 8


@dataclass(frozen=True)
class Axis:
    """Linear axis: the values at its first and last edge, in drawing direction, and its label."""

    first: float
    last: float
    name: str

    @property
    def length(self) -> float:
        """Distance between the axis' ends."""
        return abs(self.last - self.first)

    def share(self, value: float) -> float:
        """Return the relative position of a value between the first edge, 0, and the last one, 1."""
        return (value - self.first) / (self.last - self.first)

    def ticks(self, most: int) -> list[float]:
        """Return round numbers within the axis, at most about ``most``."""
        return ticks(min(self.first, self.last), max(self.first, self.last), most)

    def marks(self, pixels: int, room: int | None = None) -> list[tuple[float, str]]:
        """Return tick positions in pixels and tick labels, as many as fit, or one for every ``room`` pixels."""
        for most in range(MOST, 0, -1):
            found = sorted((self.share(value) * pixels, format_number(value)) for value in self.ticks(most))
            sizes = [room or font(TICK).getlength(text) for _, text in found]
            steps = zip(found, found[1:], sizes, sizes[1:], strict=False)
            if all(b[0] - a[0] >= (left + right) / 2 + GAP for a, b, left, right in steps):
                return found
        return []


def ticks(first: float, last: float, most: int = MOST) -> list[float]:
    """Return round numbers from first to last, at most about ``most``; empty if none lies between them."""
    raw = (last - first) / most
    power = 10.0 ** floor(log10(raw))
    step = next(step for step in (power, 2 * power, 5 * power, 10 * power) if step >= raw * (1 - 1e-9))
    numbers = range(ceil(first / step - 1e-6), floor(last / step + 1e-6) + 1)
    return [float(f"{number * step:.12g}") for number in numbers]
