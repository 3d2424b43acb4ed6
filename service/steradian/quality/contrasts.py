"""Contrast, CNR and modulation depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.quality.regions import same_shape


def contrast(image: ArrayLike, inside: ArrayLike, outside: ArrayLike | None = None) -> float:
    """Return the Michelson contrast of the means: (mean inside − mean outside)/(|mean inside| + |mean outside|).

    Parameters
    ----------
    image
        Projection or volume.
    inside
        Boolean array of its shape: the object.
    outside
        Boolean array: the background; ``None``: all that is not inside.

    Returns
    -------
    float
        Within [−1, 1]; 1 where the background averages to nothing.

    Raises
    ------
    InvalidInput
        When a region is empty or of another shape.
    """
    object_, background = _parts(image, inside, outside)
    a, b = float(object_.mean()), float(background.mean())
    total = abs(a) + abs(b)
    return (a - b) / total if total else 0.0


def contrast_to_noise(image: ArrayLike, inside: ArrayLike, outside: ArrayLike | None = None) -> float:
    """Return (mean inside − mean outside)/background's standard deviation; parameters as in :func:`contrast`."""
    object_, background = _parts(image, inside, outside)
    return _ratio(float(object_.mean() - background.mean()), float(background.std()))


def peak_to_background(image: ArrayLike, inside: ArrayLike, outside: ArrayLike | None = None) -> float:
    """Return the object's maximum over the background's RMS; parameters as in :func:`contrast`.

    Returns
    -------
    float
        A ratio of amplitudes; infinite where the background is empty of signal.
    """
    object_, background = _parts(image, inside, outside)
    return _ratio(float(object_.max()), float(np.sqrt(np.mean(background**2))))


def modulation(profile: ArrayLike) -> float:
    """Return a profile's modulation depth: (bright − dark)/(bright + dark) of its 90th and 10th percentile.

    Percentiles instead of the extremes keep a single noisy sample from deciding. A sine keeps 95 % of its depth.

    Parameters
    ----------
    profile
        Intensities (N,) across several line pairs; negative ones count as 0.

    Returns
    -------
    float
        Within [0, 1].

    Raises
    ------
    InvalidInput
        When there are fewer than 4 values.
    """
    values = np.clip(np.asarray(profile, dtype=np.float64).ravel(), 0, None)
    if len(values) < 4:
        raise InvalidInput("profile", f"{len(values)} values", "at least 4 values")
    dark, bright = np.percentile(values, [10, 90])
    return float((bright - dark) / (bright + dark)) if bright > 0 else 0.0


def _ratio(a: float, b: float) -> float:
    return a / b if b else float(np.copysign(np.inf, a)) if a else 0.0


def _parts(
    image: ArrayLike, inside: ArrayLike, outside: ArrayLike | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the values of object and background."""
    values = np.asarray(image)
    parts = []
    region = np.asarray(inside, dtype=bool)
    other = ~region if outside is None else np.asarray(outside, dtype=bool)
    for name, where in (("inside", region), ("outside", other)):
        same_shape(name, where, values.shape, "the image")
        if not where.any():
            raise InvalidInput(name, "empty", "at least one element")
        parts.append(values[where].astype(np.float64))
    return parts[0], parts[1]
