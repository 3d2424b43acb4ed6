"""The order in which a scanner visits a mask's points."""

from __future__ import annotations

from enum import StrEnum
from math import ceil, sqrt

import numpy as np
from numpy.typing import NDArray


class VisitOrder(StrEnum):
    """How the points are ordered."""

    GIVEN = "given"
    """As the mask lists them."""
    SNAKE = "snake"
    """In strips, up one and down the next."""


def visit_order(positions: NDArray[np.float64], order: VisitOrder) -> NDArray[np.int64]:
    """Order points for a visit.

    Parameters
    ----------
    positions
        (M, 2) positions x, y in metres.
    order
        Which rule to follow.

    Returns
    -------
    ndarray
        (M,) indices into ``positions``; each occurs once.
    """
    if order is VisitOrder.GIVEN:
        return np.arange(len(positions))
    x, y = positions.T
    width = float(np.ptp(x))
    # In strips of width w over an area A, travel is about A/w along and n·w/3 across them: least at w = √(3A/n).
    strips = max(1, ceil(width / sqrt(3 * max(width * float(np.ptp(y)), 1e-30) / len(x))))
    strip = np.minimum((x - x.min()) / max(width, 1e-30) * strips, strips - 1).astype(np.int64)
    return np.lexsort((np.where(strip % 2 == 0, y, -y), strip))


def travel(positions: NDArray[np.float64], visit: NDArray[np.int64]) -> float:
    """Length in metres of the way from point to point in the order ``visit``."""
    return float(np.linalg.norm(np.diff(positions[visit], axis=0), axis=1).sum())
