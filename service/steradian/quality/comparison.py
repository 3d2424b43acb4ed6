"""Comparison of an image with a reference by all quality metrics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.quality.pearson import correlation
from steradian.quality.regions import above_threshold, disc
from steradian.quality.sharpness import tenenbaum

if TYPE_CHECKING:
    from steradian.imaging.volume import Volume

AXES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")


def compare(
    volume: Volume,
    reference: Volume,
    *,
    diameter: float | None = None,
    threshold: float = 0.04,
    centre: tuple[float, float] = (0.0, 0.0),
) -> dict[str, float]:
    """Compare an image with a reference on the same voxels, by metrics of the projections and of the volume.

    Parameters
    ----------
    volume, reference
        3-D, or 2-D images [x, z], with the same axes.
    diameter
        Lateral region of interest in metres: a disc in the z-projection and its cylinder in the volume, a strip in the
        other projections and in 2-D. ``None``: everywhere.
    threshold
        Share of the reference's maximum from which pixels are *of interest* (paper, section 6: 4 %).
    centre
        Middle of the lateral region in metres, x and y.

    Returns
    -------
    dict
        ``mip_{x,y,z}_correlation``: over the pixels of interest; ``mip_z_sharpness`` and
        ``mip_z_reference_sharpness``: normalised Tenenbaum function on the rectangle around them, each image divided
        by its maximum there; ``volume_correlation``: over all voxels of the lateral region;
        ``volume_correlation_of_interest``: over the voxels of interest alone, which leaves out artefacts elsewhere;
        ``volume_sharpness``, ``volume_reference_sharpness``; ``volume_error``: l2 distance over the reference's norm
        after the best common factor; ``volume_amplitude``: the multiple of the reference that the image holds.
        In 2-D the keys begin with ``image_`` in place of ``volume_`` and there are no projections.

    Raises
    ------
    InvalidInput
        When the images have different voxels, or the region is empty.
    """
    _same_voxels(volume, reference)
    name = "volume" if volume.dimensions == 3 else "image"
    lateral = _lateral_region(volume, diameter, centre)
    figures: dict[str, float] = {}
    if volume.dimensions == 3:
        for axis in AXES:
            image, model = volume.mip(axis), reference.mip(axis)
            within = lateral[..., 0] if axis == "z" else lateral.any(axis=AXES.index(axis))
            region = _region(np.broadcast_to(within, image.shape), model, threshold)
            figures[f"mip_{axis}_correlation"] = correlation(image, model, region)
            if axis == "z":
                figures |= _sharpness("mip_z", image, model, region)
    cylinder = np.broadcast_to(lateral, volume.values.shape)
    figures[f"{name}_correlation"] = correlation(volume.values, reference.values, cylinder)
    interest = _region(cylinder, reference.values, threshold)
    figures[f"{name}_correlation_of_interest"] = correlation(volume.values, reference.values, interest)
    figures |= _sharpness(name, volume.values, reference.values, interest)
    return figures | _scale(name, volume.values, reference.values, lateral)


def _same_voxels(volume: Volume, reference: Volume) -> None:
    if volume.values.shape != reference.values.shape:
        raise InvalidInput("reference", f"shape {reference.values.shape}", f"the image's, {volume.values.shape}")
    for axis, step in zip(volume.names, volume.spacing, strict=True):
        apart = float(np.abs(volume.coordinates(axis) - reference.coordinates(axis)).max())
        if apart > 0.01 * step:
            raise InvalidInput("reference", f"voxels {apart:g} m apart along {axis}", "the image's voxels within 1 %")


def _lateral_region(volume: Volume, diameter: float | None, centre: tuple[float, float]) -> NDArray[np.bool_]:
    """Return the lateral region with an added axis of length 1 for depth."""
    x, y = volume.axes.x, volume.axes.y
    if y is None:
        half = np.inf if diameter is None else diameter / 2
        strip: NDArray[np.bool_] = (np.abs(x - centre[0]) <= half)[:, None]
        return strip
    if diameter is None:
        return np.ones((len(x), len(y), 1), dtype=bool)
    return disc(x, y, diameter, centre)[..., None]


def _region(lateral: NDArray[np.bool_], model: NDArray[Any], threshold: float) -> NDArray[np.bool_]:
    """Return the mask of reference elements above the threshold within the lateral region."""
    found: NDArray[np.bool_] = lateral & above_threshold(model, threshold)
    if found.sum() < 2:
        raise InvalidInput("diameter", "fewer than 2 voxels of interest inside", "a region that covers the object")
    return found


def _sharpness(name: str, image: NDArray[Any], model: NDArray[Any], region: NDArray[np.bool_]) -> dict[str, float]:
    sharpness = {}
    for key, values in ((f"{name}_sharpness", image), (f"{name}_reference_sharpness", model)):
        peak = float(values[region].max())
        sharpness[key] = tenenbaum(values, region) / peak**2 if peak > 0 else float("nan")
    return sharpness


def _scale(name: str, values: NDArray[Any], model: NDArray[Any], lateral: NDArray[np.bool_]) -> dict[str, float]:
    """Return the relative l2 error after the best common scale factor, computed row by row in float64."""
    cross = own = other = 0.0
    for row, wanted, inside in zip(values, model, lateral, strict=True):
        u, v = (np.where(inside, part, 0).astype(np.float64) for part in (row, wanted))
        cross, own, other = cross + float(np.vdot(u, v)), own + float(np.vdot(u, u)), other + float(np.vdot(v, v))
    error = float(np.sqrt(max(0.0, 1 - cross**2 / (own * other)))) if own and other else 1.0
    return {f"{name}_error": error, f"{name}_amplitude": float(cross / other) if other else float("nan")}
