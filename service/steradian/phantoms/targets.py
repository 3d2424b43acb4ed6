"""Flat resolution targets parallel to the sensor plane, sampled by Gaussian balls on a fine square grid.

A chrome pattern is far thinner than any wavelength, and the film's band limits what can be seen of its edges: balls of
s = 9 µm fall to −3 dB at 22 MHz, as the simulated film does, so they stand for an ideal pattern behind such a film.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fabry_perot.simulator.phantoms import Balls

Array = NDArray[np.float64]
SIGMA = 9e-6
"""Radius s in m of the balls that targets are made of."""
PITCH = 15e-6
"""Distance in m between them: below 1.7 s, where their sum is even to a tenth of a percent."""
_FINE = 4
Bar = tuple[float, float, float, float]
"""Left, right, low and high end in m."""


def star(
    *,
    sectors: int = 72,
    diameter: float = 5e-3,
    core: float = 100e-6,
    depth: float = 4e-3,
    centre: tuple[float, float] = (0.0, 0.0),
) -> Balls:
    """Return a phantom of a star target (Siemens star) with the paper's dimensions (section 3).

    Parameters
    ----------
    sectors
        Bright and dark ones together.
    diameter, core
        Of the pattern, and of its filled middle, in m.
    depth
        Distance from the sensor plane in m.
    centre
        In m.
    """

    def covered(x: Array, y: Array) -> NDArray[np.bool_]:
        r, angle = np.hypot(x, y), np.arctan2(y, x)
        bright = np.cos(angle * sectors / 2) > 0
        return (r <= diameter / 2) & (bright | (r <= core / 2))

    return _covered(covered, diameter / 2, depth, centre)


def chart(*, depth: float = 4e-3, groups: int = 6, size: float = 3e-3, largest: float = 300e-6) -> Balls:
    """Return a phantom of USAF 1951 triple bars, upright and lying, each group 2^(−1/3) narrower than the last.

    Parameters
    ----------
    depth
        Distance from the sensor plane in m.
    groups
        Pairs of triple bars; the k-th has bars of width w_k = ``largest``·2^(−k/3), distances w_k and length 5·w_k.
    size
        Half of the side of the square that holds them, in m: they are laid out in rows from its corner.
    largest
        Width of the widest bars in m.
    """
    bars = chart_bars(groups=groups, size=size, largest=largest)

    def covered(x: Array, y: Array) -> NDArray[np.bool_]:
        inside = np.zeros(x.shape, dtype=bool)
        for left, right, low, high in bars:
            inside |= (x >= left) & (x < right) & (y >= low) & (y < high)
        return inside

    return _covered(covered, size, depth, (0.0, 0.0))


def chart_bars(*, groups: int = 6, size: float = 3e-3, largest: float = 300e-6) -> list[Bar]:
    """Return the rectangles of :func:`chart`'s bars, three upright and three lying ones a group."""
    bars: list[Bar] = []
    x, y, row = -size, -size, 0.0
    for k in range(groups):
        w = largest * 2 ** (-k / 3)
        if x + 12 * w > size:
            x, y, row = -size, y + row + largest, 0.0
        bars += [(x + 2 * i * w, x + (2 * i + 1) * w, y, y + 5 * w) for i in range(3)]
        bars += [(x + 7 * w, x + 12 * w, y + 2 * i * w, y + (2 * i + 1) * w) for i in range(3)]
        x, row = x + 12 * w + largest, max(row, 5 * w)
    return bars


def _covered(
    pattern: Callable[[Array, Array], NDArray[np.bool_]], half: float, depth: float, centre: tuple[float, float]
) -> Balls:
    """Return Gaussian balls on a grid, weighted by the fraction of their cell that the pattern covers.

    The sum of balls of amplitude a at distance d is that of a sheet: a·2π·s²/d² of one ball's peak; the amplitudes are
    chosen so that a wide covered area has the initial pressure 1 in its middle.
    """
    count = int(np.ceil(half / PITCH)) + 1
    axis = PITCH * np.arange(-count, count + 1)
    inner = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    share = np.zeros((len(axis), len(axis)))
    for dx in inner * PITCH:
        for dy in inner * PITCH:
            share += pattern(*np.meshgrid(axis + dx, axis + dy, indexing="ij"))
    share /= _FINE**2
    i, j = np.nonzero(share)
    centres = np.column_stack([axis[i] + centre[0], axis[j] + centre[1], np.full(len(i), depth)])
    amplitudes = share[i, j] * PITCH**2 / (2 * np.pi * SIGMA**2)
    return Balls(centres, np.full(len(i), SIGMA), amplitudes)
