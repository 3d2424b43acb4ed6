"""Partition of bias wavelengths into bands to minimise retuning time.

Tuning the interrogation laser takes longer than moving the beam, and a point may be read a little beside its best
wavelength for a little less signal. So points whose best wavelengths lie close together share one, within a loss of
sensitivity that is stated, and each band is measured on a short way of its own. (Measuring in order of wavelength
made scans of an uneven film about seven times faster: arXiv 2511.23435.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steradian.plans.curve_orders import hilbert
from steradian.plans.fringe import Fringe
from steradian.plans.motion_timing import MotionTiming

CELLS = 64
"""Optima are put into cells of a 64th of the widest band before bands are chosen; limits hold for each point."""
UNIFORM_TOLERANCE = 1.005
"""Ways so little longer than the shortest count as even: the one that loses less sensitivity is taken."""
MAX_RATIO = 1.5
"""The shortest way is searched where a curve through all points is at most so many times slower than the bands."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TunedOrder:
    """Order of interrogation with the bias wavelength of each point.

    Attributes
    ----------
    visit
        (M,) indices of points in the order of interrogation.
    bias
        (M,) wavelength that is set at each point of the mask, in m.
    """

    visit: NDArray[np.int64]
    bias: Array


def partition_bands(optima: Array, reach: tuple[float, float], fringe: Fringe) -> Array:
    """Partition wavelengths into the fewest bands, with a low loss of sensitivity.

    Dynamic programming over the sorted optima: the fewest bands first, then the least sum of squared distances from
    the bands' means, as a loss grows with the square of the detuning.

    Parameters
    ----------
    optima
        (M,) best wavelengths in m.
    reach
        How far below and above its optimum a point may be read, in m.
    fringe
        Tells what a detuning loses.

    Returns
    -------
    ndarray
        (M,) the wavelength of each point's band in m.
    """
    low, high = reach
    width = low + high
    cell = np.floor((optima - optima.min()) / (width / CELLS)).astype(np.int64)
    members, cell = np.unique(cell, return_inverse=True)
    lowest, highest = np.full(len(members), np.inf), np.full(len(members), -np.inf)
    np.minimum.at(lowest, cell, optima)
    np.maximum.at(highest, cell, optima)
    from_lowest = (optima - optima.min()) / width
    sums = [np.concatenate([[0.0], np.cumsum(np.bincount(cell, from_lowest**power))]) for power in (0, 1, 2)]
    first = np.searchsorted(lowest, highest - width)  # a band that ends here begins here at the earliest
    best, begin = np.zeros(len(members) + 1), np.zeros(len(members) + 1, np.int64)
    for end in range(1, len(members) + 1):
        begins = np.arange(first[end - 1], end)
        count, total, squares = (powers[end] - powers[begins] for powers in sums)
        spread = np.maximum(squares - total**2 / count, 0.0)
        costs = best[begins] + (len(optima) + 1.0) + spread  # all spread together is less than one band more
        chosen = int(np.argmin(costs))
        best[end], begin[end] = costs[chosen], begins[chosen]
    ends = [len(members)]
    while ends[-1]:
        ends.append(int(begin[ends[-1]]))
    band = np.searchsorted(np.array(ends[::-1][1:]), cell, side="right")
    ranked = np.argsort(band, kind="stable")
    bias = np.empty(len(optima))
    for here in np.split(ranked, np.flatnonzero(np.diff(band[ranked])) + 1):
        bias[here] = _middle(optima[here], reach, fringe)
    return bias


def _middle(optima: Array, reach: tuple[float, float], fringe: Fringe) -> float:
    """Return the wavelength of a band with the least mean loss, within every point's tolerance."""
    low, high = reach
    from_, to = optima.max() - low, optima.min() + high
    if from_ >= to:
        return float((from_ + to) / 2)
    tried = np.linspace(from_, to, 65)
    tried = np.append(tried, np.clip(optima.mean(), from_, to))
    levels = np.quantile(optima, np.linspace(0, 1, 101)) if len(optima) > 101 else optima
    return float(tried[np.argmin(fringe.sensitivity_loss(tried[:, None] - levels).mean(axis=1))])


def hold_wavelength(optima: Array, reach: tuple[float, float]) -> Array:
    """Return the wavelengths of points in visit order, unchanged while within the next point's tolerance.

    Parameters
    ----------
    optima
        (M,) best wavelengths in the order of interrogation, in m.
    reach
        How far below and above its optimum a point may be read, in m.
    """
    low, high = reach
    bias, now = [], float(optima[0])
    for optimum in optima.tolist():
        if not -low <= now - optimum <= high:
            now = optimum
        bias.append(now)
    return np.array(bias)


def order_by_bands(positions: Array, optima: Array, fringe: Fringe, loss: float, pace: MotionTiming) -> TunedOrder:
    """Return an order of points with a short total time of moving and tuning.

    Compared are bands of wavelength, each on a short way of its own; one short way through all points that retunes
    when a point would lose too much; and the same way tuned at every point, which costs nothing where the laser's
    pulses are far apart. Of those that take the same time the one that loses least is taken.

    Parameters
    ----------
    positions
        (M, 2) in m.
    optima
        (M,) best wavelengths in m.
    fringe, loss
        What a detuning loses, and how much of the sensitivity a point may lose.
    pace
        Tells how long a way takes.
    """
    from steradian.plans.tour import short_tour, tour_by_group

    tolerance, allowed = pace.tuning.tolerance, fringe.wavelength_tolerance(loss)
    reaches = [(min(tolerance, allowed[0]), min(tolerance, allowed[1])), allowed] if loss else [(tolerance, tolerance)]

    def seconds(one: TunedOrder) -> float:
        return pace.seconds(positions[one.visit], one.bias[one.visit])

    curve = hilbert(positions)  # nearly as short as the shortest way, at once
    outlook = min(seconds(_on_the_way(curve, optima, reach)) for reach in reaches)
    found: list[TunedOrder] = []
    if len(reaches) > 1 and outlook > UNIFORM_TOLERANCE * len(optima) / pace.pulse_rate:
        bias = partition_bands(optima, reaches[1], fringe)
        found.append(TunedOrder(tour_by_group(positions, bias), bias))
    if not found or outlook < MAX_RATIO * seconds(found[0]):
        visit = short_tour(positions)
        found += [_on_the_way(visit, optima, reach) for reach in reaches]
    quickest = min(map(seconds, found))
    even = [one for one in found if seconds(one) <= UNIFORM_TOLERANCE * quickest]
    return min(even, key=lambda one: float(fringe.sensitivity_loss(one.bias - optima).mean()))


def _on_the_way(visit: NDArray[np.int64], optima: Array, reach: tuple[float, float]) -> TunedOrder:
    bias = np.empty(len(optima))
    bias[visit] = hold_wavelength(optima[visit], reach)
    return TunedOrder(visit, bias)
