"""Normalisation of the pulse energies stated in an imported file."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.scans.importing.import_remarks import remark


def relative_energies(values: NDArray[Any] | None, frames: int, points: int) -> NDArray[np.float64] | None:
    """Return the pulse energy of each A-line divided by the mean energy, frame after frame.

    Parameters
    ----------
    values
        Energies in any unit: of each A-line (frames, points) or (points, frames), of each sensor, or of each frame;
        ``None`` or one number: not known.
    frames, points
        What the A-lines have.

    Returns
    -------
    NDArray or None
        (frames·points,); ``None``, with a note, of another number of values, or where one cannot be an energy.
    """
    if values is None or values.size == 1:
        return None
    given = np.asarray(values, np.float64)
    if given.size == frames * points:
        whole = given.T if given.shape == (points, frames) and points != frames else given
        each = whole.reshape(-1)
    elif given.size == points:
        each = np.tile(given.reshape(-1), frames)
    elif given.size == frames:
        each = np.repeat(given.reshape(-1), points)
    else:
        remark(
            f"the file's {given.size} pulse energies are not used: they are as many as neither the {frames * points} "
            f"A-lines, the {points} sensors nor the {frames} frames"
        )
        return None
    if not (np.isfinite(each).all() and each.min() >= 0 and each.max() > 0):
        remark("the file's pulse energies are not used: they must be finite, at least 0, and not all 0")
        return None
    low, high = each.min() / each.mean(), each.max() / each.mean()
    remark(f"the file's pulse energies, {low:.3g} to {high:.3g} of their mean, are kept; images are divided by them")
    return np.asarray(each / each.mean())
