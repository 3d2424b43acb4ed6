"""Full width at half maximum of a profile: the one definition for library, page, command line and HTTP.

The width is the distance between the two places where the profile falls to half of the peak's height above the local
base. The base is the median of the samples further than one width from the peak on either side; where fewer than 8
samples lie there, it is 0. ``docs/method.md`` tells why.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput

Array = NDArray[np.float64]
FEWEST_BESIDE = 8
"""Samples beside the peak from which base and noise are read."""
_TURNS = 3


@dataclass(frozen=True, slots=True)
class Width:
    """Measured full width at half maximum; lengths in the unit of the coordinate, metres for volumes.

    Attributes
    ----------
    fwhm
        Distance between the two crossings of half the peak's height above ``base``, as the image shows it: the object
        widened by the point spread, or narrowed by the limited view.
    repeatability
        Standard deviation of ``fwhm`` under the noise beside the peak; it contains neither the point spread nor the
        limited view. ``None`` where fewer than 8 samples beside the peak tell the noise, or most of them are equal, as
        in non-negative images.
    base
        Level that the height is counted from.
    height
        Of the peak above the base.
    centre, left, right
        Middle between the crossings, and the crossings.
    point_spread
        Width of the image of an object without a width at this place, measured in the same direction; ``None`` where it
        has not been simulated (:func:`steradian.reconstructions.studies.width.measure_width` does).
    corrected
        Diameter of the uniform cylinder or sphere whose image at this place is as wide as ``fwhm``; ``None`` where that
        is not possible, which ``reason`` tells.
    at_most
        Largest diameter that fits, where the image is hardly wider than the point spread.
    shape
        What was simulated: "cylinder" or "sphere"; "" where nothing was.
    reason
        Why there is no ``corrected``; "" where there is one.
    """

    fwhm: float
    repeatability: float | None
    base: float
    height: float
    centre: float
    left: float
    right: float
    point_spread: float | None = None
    corrected: float | None = None
    at_most: float | None = None
    shape: str = ""
    reason: str = "the point spread at this place has not been simulated"


def width(x: ArrayLike, values: ArrayLike, *, base: float | None = None) -> Width:
    """Measure the full width at half maximum of a profile's highest peak.

    Parameters
    ----------
    x
        Ascending coordinates (N,).
    values
        Profile (N,).
    base
        Level that the peak's height is counted from; ``None``: read from the profile beside the peak.

    Returns
    -------
    Width
        Without the figures of a point spread.

    Raises
    ------
    InvalidInput
        When the profile is not two vectors of one length ≥ 2, or does not fall to a half on both sides of its peak.
    """
    at, profile = samples("x", x, values, 2)
    found = find_width(at, profile, base)
    if found is None:
        raise InvalidInput("values", "no fall to a half on both sides of the peak", "a profile across one object")
    return found


def find_width(at: Array, values: Array, base: float | None = None) -> Width | None:
    """Measure the width as :func:`width`; return ``None`` if the profile has no half-maximum crossing on a side."""
    top, level = int(values.argmax()), 0.0 if base is None else base
    found = _crossings(at, values, top, level)
    beside: Array = np.empty(0)
    for _ in range(_TURNS):
        if found is None:
            return None
        left, right = found[0], found[1]
        reach = right - left
        beside = values[(at < left - reach) | (at > right + reach)]
        if len(beside) < FEWEST_BESIDE or base is not None:
            break
        level = float(np.median(beside))
        found = _crossings(at, values, top, level)
    if found is None:
        return None
    left, right, rise, fall = found
    error = None
    if len(beside) >= FEWEST_BESIDE:
        noise = 1.4826 * float(np.median(np.abs(beside - np.median(beside))))
        error = noise * float(np.linalg.norm([1 / rise, 1 / fall, 0.5 * (1 / rise + 1 / fall)])) or None
    height = float(values[top]) - level
    return Width(right - left, error, level, height, (left + right) / 2, left, right)


def _crossings(at: Array, values: Array, top: int, base: float) -> tuple[float, float, float, float] | None:
    """Return the coordinates at which the profile crosses half maximum on either side, and its slopes there."""
    if not values[top] > base:
        return None
    half = (values[top] + base) / 2
    ends, slopes = [], []
    for order in (slice(top, None, -1), slice(top, None)):
        side, where = values[order], at[order]
        below = np.flatnonzero(side <= half)
        if not len(below):
            return None
        i = int(below[0])
        share = (side[i - 1] - half) / (side[i - 1] - side[i])
        ends.append(float(where[i - 1] + share * (where[i] - where[i - 1])))
        slopes.append(abs(float((side[i] - side[i - 1]) / (where[i] - where[i - 1]))))
    return ends[0], ends[1], slopes[0], slopes[1]


def samples(name: str, x: ArrayLike, intensity: ArrayLike, least: int) -> tuple[Array, Array]:
    """Validate a profile: two finite vectors of one length ≥ ``least``, the first ascending; raises InvalidInput."""
    at, values = np.asarray(x, dtype=np.float64), np.asarray(intensity, dtype=np.float64)
    if at.ndim != 1 or values.shape != at.shape or len(at) < least:
        raise InvalidInput(name, f"shapes {at.shape} and {values.shape}", f"two vectors of one length ≥ {least}")
    if not (np.isfinite(values).all() and (np.diff(at) > 0).all()):
        raise InvalidInput(name, "not ascending, or values not finite", "ascending coordinates of finite values")
    return at, values
