"""Visit order of a mask's points by a scanner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from steradian.core.choices import VisitOrder
from steradian.core.exceptions import InvalidInput
from steradian.masks import Mask
from steradian.plans.curve_orders import boustrophedon, hilbert
from steradian.plans.progressive_order import progressive


def visit_order(
    positions: NDArray[np.float64],
    order: VisitOrder,
    *,
    mask: Mask | None = None,
    wavelengths: NDArray[np.float64] | None = None,
    wavelength_step: float = 0.0,
) -> NDArray[np.int64]:
    """Return the visit order of points by a named method.

    Parameters
    ----------
    positions
        (M, 2) positions x, y in metres.
    order
        Which rule to follow.
    mask
        The mask of these points, for its point of interest and weights (progressive order).
    wavelengths
        (M,) bias wavelength of each point in metres (wavelength order).
    wavelength_step
        Wavelengths this close in metres need no retuning.

    Returns
    -------
    ndarray
        (M,) indices into ``positions``; each occurs once.

    Raises
    ------
    InvalidInput
        When the order needs wavelengths and there are none.
    """
    match order:
        case VisitOrder.GIVEN:
            return np.arange(len(positions))
        case VisitOrder.SNAKE:
            return boustrophedon(positions)
        case VisitOrder.HILBERT:
            return hilbert(positions)
        case VisitOrder.SHORTEST:
            from steradian.plans.tour import short_tour

            return short_tour(positions)
        case VisitOrder.WAVELENGTH:
            if wavelengths is None:
                raise InvalidInput("order", "wavelength", "an order without wavelengths; this plan has no wavelengths")
            return by_wavelength(positions, wavelengths, wavelength_step)
        case VisitOrder.BANDS:
            raise InvalidInput("order", "bands", "an order of points alone; bands are a plan's, see ScanPlan.tuned")
        case VisitOrder.PROGRESSIVE:
            return progressive(positions, mask).visit


def by_wavelength(positions: NDArray[np.float64], wavelengths: NDArray[np.float64], step: float) -> NDArray[np.int64]:
    """Return the order by ascending groups of bias wavelength; ``step`` is the width of a group in metres."""
    from steradian.plans.tour import tour_by_group

    group = np.unique(wavelengths, return_inverse=True)[1].reshape(-1)
    if step > 0:
        group = np.floor((wavelengths - wavelengths.min()) / step).astype(np.int64)
    return tour_by_group(positions, group)


def path_length(positions: NDArray[np.float64], visit: NDArray[np.int64]) -> float:
    """Return the length in metres of the path through the points in the order ``visit``."""
    return float(np.linalg.norm(np.diff(positions[visit], axis=0), axis=1).sum())
