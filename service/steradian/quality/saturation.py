"""Detection of saturated A-lines: many samples equal an extreme value, and few lie just below."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

PAIRS: Final = 2
"""Pairs of neighbouring samples at extreme values from which an A-line is saturated, if half as many lie just below."""
MANY: Final = 7
"""Samples at extreme values from which it is, if fewer lie just below."""
BELOW: Final = 0.1
"""What is just below an extreme value: this share of half the A-line's range, at least 5 codes."""
LEAST: Final = 5


def flat_ends(block: NDArray[np.number[Any]]) -> NDArray[np.int64]:
    """Count (n, 3) per A-line: neighbouring sample pairs at an extreme value, samples there, and just below.

    Both the least and the greatest value of each A-line count.

    Parameters
    ----------
    block
        (n, N_t) A-lines; integers are codes.
    """
    found = np.zeros((len(block), 3), np.int64)
    low, high = block.min(axis=1), block.max(axis=1)
    wide = BELOW * (high.astype(np.float64) - low) / 2
    whole = block.dtype.kind in "iu"
    if whole:
        wide = np.maximum(np.floor(wide), LEAST)
    for ends, sign in ((low, 1), (high, -1)):
        at_end = block == ends[:, None]
        equal = np.count_nonzero(at_end, axis=1)
        found[:, 1] += equal
        several = np.flatnonzero(equal > 1)
        if not len(several):
            continue
        found[several, 0] += np.count_nonzero(at_end[several, 1:] & at_end[several, :-1], axis=1)
        some, least = block[several], ends[several].astype(np.float64) + sign * wide[several]
        if whole:
            limits: Any = np.iinfo(block.dtype.name)
            least = np.clip(least, limits.min, limits.max)
        bound = least.astype(block.dtype)[:, None]
        found[several, 2] += np.count_nonzero(some <= bound if sign > 0 else some >= bound, axis=1) - equal[several]
    return found


def is_saturated(ends: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether A-lines are saturated, shape (n,), from the counts of :func:`flat_ends` (n, 3)."""
    pairs, equal, below = ends.T
    few = (pairs >= PAIRS) & (equal > 2 * below)
    return np.asarray(few | ((pairs > 0) & (equal >= MANY) & (equal > below)))
