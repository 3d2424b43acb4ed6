"""Construction of any mask arrangement from a target number of points.

Not every arrangement can have every number of points; each function here finds the nearest that it can have.
"""

from __future__ import annotations

from math import floor, sqrt
from typing import Literal, TypeAlias, get_args

from steradian.core.exceptions import InvalidInput
from steradian.masks.arrangement_base import MAX_POINTS, check_offset
from steradian.masks.equi_steradian import equi_steradian_mask
from steradian.masks.grid import grid_mask
from steradian.masks.hexagonal import hexagonal_mask
from steradian.masks.mask import Mask
from steradian.masks.random_masks import poisson_disc_mask, random_mask

Counted: TypeAlias = Literal["equi-steradian", "grid", "hexagonal", "poisson-disc", "random"]
"""Arrangements of a plane that a number of points and perhaps a depth describe."""


def mask_by_count(
    arrangement: Counted,
    aperture: float,
    count: int,
    *,
    depth: float | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
) -> Mask:
    """Return a mask of about ``count`` points over the aperture, the nearest number possible.

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
    if count < 1 or count > MAX_POINTS:
        raise InvalidInput("count", count, f"1 to {MAX_POINTS} (points)")
    match arrangement:
        case "equi-steradian":
            if depth is None:
                raise InvalidInput("depth", "missing", "> 0, at most 1 (m)")
            return equi_steradian_mask(aperture, depth, count, offset=offset)
        case "grid":
            side = nearest_square(count)
            return grid_mask(aperture, side, aperture / side, centred=True, depth=depth, offset=offset)
        case "hexagonal":
            return hexagonal_mask(aperture, count=count, depth=depth, offset=offset)
        case "poisson-disc":
            return poisson_disc_mask(aperture, count=count, depth=depth, offset=offset, seed=seed)
        case "random":
            return random_mask(aperture, count, depth=depth, offset=offset, seed=seed)
        case _:
            raise InvalidInput("arrangement", arrangement, ", ".join(get_args(Counted)))


def with_point_of_interest(mask: Mask, depth: float, offset: tuple[float, float] = (0.0, 0.0)) -> Mask:
    """Return a mask with a point of interest for its metrics; the points are unchanged.

    Raises
    ------
    InvalidInput
        When the point of interest is not over the aperture.
    """
    check_offset(offset, mask.aperture)
    return mask.replace(depth=depth, offset=offset)


def nearest_square(count: int) -> int:
    """Return the side n of the grid of n × n points nearest to ``count``."""
    side = max(1, floor(sqrt(count)))
    return side + 1 if (side + 1) ** 2 - count <= count - side**2 else side
