"""Sharpness of an image: the normalised Tenenbaum function (paper, appendix B)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.quality.regions import bounding_slices, same_shape


def tenenbaum(image: ArrayLike, region: ArrayLike | None = None) -> float:
    """Return the sharpness: mean squared Sobel gradient of an image or volume (Tenenbaum's function by element).

    It grows with the square of the image's scale: to compare the sharpness of two images, first divide each by its
    maximum (:func:`steradian.quality.compare` does). Gradients need neighbours, so the outermost elements of the image
    have none and do not count; those of a region's rectangle take the image's next ones.

    Parameters
    ----------
    image
        Two or three axes, each at least 3 long; per axis the operator is (−1, 0, 1) along it and (1, 2, 1) across.
    region
        Boolean array of the image's shape; the smallest rectangle that contains it is used, since gradients cannot be
        taken between elements that are not adjacent (paper, section 6). ``None``: the whole image.

    Returns
    -------
    float
        At least 0, in the square of the image's unit.

    Raises
    ------
    InvalidInput
        When the image or rectangle is too small, or the region's shape differs.
    """
    values = np.asarray(image)
    if values.ndim not in (2, 3):
        raise InvalidInput("image", f"an array of shape {values.shape}", "two or three axes")
    if region is not None:
        inside = np.asarray(region, dtype=bool)
        same_shape("region", inside, values.shape, "the image")
        values = values[tuple(slice(max(0, s.start - 1), s.stop + 1) for s in bounding_slices(inside))]
    if min(values.shape) < 3:
        raise InvalidInput("image", f"a rectangle of shape {values.shape}", "at least 3 elements along each axis")
    return float(sum(np.mean(np.square(sobel(values, axis), dtype=np.float64)) for axis in range(values.ndim)))


def sobel(image: ArrayLike, axis: int) -> NDArray[np.floating]:
    """Apply Sobel's gradient operator along one axis, without the borders.

    Parameters
    ----------
    image
        Any number of axes, each at least 3 long.
    axis
        The axis of the derivative.

    Returns
    -------
    ndarray
        Shorter by 2 along each axis; 8 times the slope an element in 2-D, 32 times in 3-D. float32 stays float32.
    """
    from scipy import ndimage

    found = np.asarray(image)
    if not np.issubdtype(found.dtype, np.floating):
        found = found.astype(np.float64)
    inside = (slice(1, -1),) * found.ndim
    return np.asarray(ndimage.sobel(found, axis)[inside])
