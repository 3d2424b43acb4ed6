"""Any arrangement by the number of its points, for one point of interest: masks on equal terms.

Not every arrangement can have every number of points; each function here finds the nearest that it can have.
"""

from __future__ import annotations

from itertools import pairwise
from math import floor, sqrt
from typing import Literal, TypeAlias, get_args

from steradian.errors import InvalidInput
from steradian.masks.equi_steradian import check_offset, equi_steradian_mask
from steradian.masks.grid import grid_mask
from steradian.masks.hexagonal import hexagonal_mask
from steradian.masks.mask import Mask
from steradian.masks.scattered import MOST_POINTS, poisson_disc_mask, random_mask

Counted: TypeAlias = Literal["equi-steradian", "grid", "hexagonal", "poisson-disc", "random"]
"""Arrangements of a plane that a number of points and perhaps a depth describe."""
TRIES = 24
"""Spacings tried for a number of Poisson-disc points, after halving."""


def counted_mask(
    arrangement: Counted,
    aperture: float,
    count: int,
    *,
    depth: float | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
) -> Mask:
    """Arrange about ``count`` points over the aperture, the nearest number that the arrangement can have.

    Parameters
    ----------
    arrangement
        ``equi-steradian``, ``grid``, ``hexagonal``, ``poisson-disc`` or ``random``.
    aperture
        Side X of the square aperture in metres.
    count
        Wanted number of points.
    depth, offset
        Of the point of interest in metres; an equi-steradian mask needs it, of the others it is what they are judged
        for.
    seed
        Of points by chance.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.

    Examples
    --------
    >>> [counted_mask(name, 13.56e-3, 2000, depth=3.6e-3).count for name in ("equi-steradian", "grid", "random")]
    [2053, 2025, 2000]
    """
    if count < 1 or count > MOST_POINTS:
        raise InvalidInput("count", count, f"1 to {MOST_POINTS} (points)")
    match arrangement:
        case "equi-steradian":
            if depth is None:
                raise InvalidInput("depth", "missing", "> 0, at most 1 (m)")
            return equi_steradian_mask(aperture, depth, count, offset=offset)
        case "grid":
            side = nearest_square(count)
            mask = grid_mask(aperture, side, aperture / side, centred=True)
        case "hexagonal":
            mask = hexagonal_mask(aperture, hexagonal_interval(aperture, count))
        case "poisson-disc":
            mask = poisson_disc_mask(aperture, poisson_spacing(aperture, count, seed), seed=seed)
        case "random":
            mask = random_mask(aperture, count, seed=seed)
        case _:
            raise InvalidInput("arrangement", arrangement, ", ".join(get_args(Counted)))
    return mask if depth is None else aimed(mask, depth, offset)


def aimed(mask: Mask, depth: float, offset: tuple[float, float] = (0.0, 0.0)) -> Mask:
    """Give a mask a point of interest, for which its promises are worked out; its points stay where they are.

    Raises
    ------
    InvalidInput
        When the point of interest is not over the aperture.
    """
    check_offset(offset, mask.aperture)
    return mask.replace(depth=depth, offset=offset)


def nearest_square(count: int) -> int:
    """Side n of the grid of n × n points nearest to ``count``."""
    side = max(1, floor(sqrt(count)))
    return side + 1 if (side + 1) ** 2 - count <= count - side**2 else side


def hexagonal_interval(aperture: float, count: int) -> float:
    """Interval in metres of the hexagonal lattice whose number of points is nearest to ``count``.

    The number changes only where a row or a column more fits, so one interval between any two such places is tried;
    of two equally near numbers the larger is taken, and of the intervals that give it the widest.
    """
    guess = aperture * sqrt(2 / sqrt(3) / count)
    columns = range(1, 2 + floor(aperture / (0.4 * guess)))
    changes = {aperture / n for n in columns} | {aperture / (n * sqrt(3)) for n in columns}
    places = sorted({value for value in changes if 0.5 * guess <= value} | {0.5 * guess, 3 * max(guess, aperture)})
    middles = [(low + high) / 2 for low, high in pairwise(places) if high > low * (1 + 1e-9)]
    return min(middles, key=lambda interval: (*_nearness(_lattice_count(aperture, interval), count), -interval))


def poisson_spacing(aperture: float, count: int, seed: int = 0) -> float:
    """Spacing in metres of Poisson-disc points of a seed whose number is as near to ``count`` as a search finds.

    Their number jumps by chance with the spacing; it is exact for most counts and off by a few at times.
    """
    low, high = 0.6, 1.1
    tried: dict[float, int] = {}

    def number(share: float) -> int:
        if share not in tried:
            spacing = aperture * share / sqrt(count)
            tried[share] = poisson_disc_mask(aperture, spacing, seed=seed, weighting="uniform").count
        return tried[share]

    for _ in range(8):
        middle = (low + high) / 2
        if number(middle) == count:
            break
        low, high = (middle, high) if number(middle) > count else (low, middle)
    centre = (low + high) / 2
    for step in range(TRIES):
        if count in tried.values():
            break
        number(centre * (1 + (-1) ** step * 0.0007 * (step // 2 + 1)))
    best = min(tried, key=lambda share: _nearness(tried[share], count))
    return aperture * best / sqrt(count)


def _lattice_count(aperture: float, interval: float) -> int:
    """Points of :func:`steradian.masks.hexagonal_mask`: rows through the centre and between its columns by turns."""
    rows, half = floor(aperture / (interval * sqrt(3))), aperture / (2 * interval)
    even = 1 + 2 * (rows // 2)
    return even * (1 + 2 * floor(half)) + (2 * rows + 1 - even) * 2 * floor(half + 0.5)


def _nearness(found: int, wanted: int) -> tuple[int, int]:
    """Order numbers of points: the nearest first, of two equally near the larger."""
    return abs(found - wanted), -found
