"""Saturated A-lines, told by samples that are equal at an extreme value."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

FLAT_RUN: Final = 4
"""Samples in a row at an A-line's extreme value from which it is saturated, if others have runs a third as long."""
PAIRS: Final = 2
"""Pairs of neighbouring samples at an extreme value from which it is saturated, if few samples are just below them."""
BELOW: Final = 0.1
"""What is just below an extreme value: this share of half the A-line's range, at least 5 codes."""


def flat_ends(block: NDArray[np.number[Any]]) -> NDArray[np.int64]:
    """Return (n, 4): longest run at an extreme value, pairs in such runs, samples at both, and samples just below them.

    Parameters
    ----------
    block
        (n, N_t) A-lines; runs are counted up to 64 samples.
    """
    found = np.zeros((len(block), 4), np.int64)
    found[:, 0] = 1
    low, high = block.min(axis=1), block.max(axis=1)
    wide = BELOW * (high.astype(np.float64) - low) / 2
    whole = block.dtype.kind in "iu"
    if whole:
        wide = np.maximum(np.floor(wide), 5)
    for ends, sign in ((low, 1), (high, -1)):
        at_end = block == ends[:, None]
        found[:, 0] = np.maximum(found[:, 0], _longest_runs(at_end))
        equal = np.count_nonzero(at_end, axis=1)
        several = np.flatnonzero(equal > 1)
        found[:, 2] += equal
        if not len(several):
            continue
        found[several, 1] += np.count_nonzero(at_end[several, 1:] & at_end[several, :-1], axis=1)
        some, least = block[several], ends[several].astype(np.float64) + sign * wide[several]
        if whole:
            limits = np.iinfo(block.dtype)
            least = np.clip(least, limits.min, limits.max)
        bound = least.astype(block.dtype)[:, None]
        found[several, 3] += np.count_nonzero(some <= bound if sign > 0 else some >= bound, axis=1) - equal[several]
    return found


def is_saturated(ends: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return (n,) whether A-lines are saturated, from their flat ends (n, 4)."""
    runs, pairs, equal, below = ends.T
    return np.asarray((runs >= np.maximum(FLAT_RUN, 3 * np.median(runs))) | ((pairs >= PAIRS) & (equal > 2 * below)))


def _longest_runs(at_end: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return (n,) lengths of the longest run of true values in each row; 64 at most."""
    longest = np.ones(len(at_end), np.int64)
    several = np.flatnonzero(np.count_nonzero(at_end, axis=1) > 1)
    run, length = at_end[several], 1
    while len(several):
        run = run[:, 1:] & at_end[several, :-length] if length < at_end.shape[1] else run[:, :0]
        still = run.any(axis=1)
        several, run = several[still], run[still]
        length += 1
        longest[several] = length
        if length >= 64:
            break
    return longest
