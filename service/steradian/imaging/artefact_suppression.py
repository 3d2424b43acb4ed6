"""Suppression of undersampling artefacts by a local Wiener filter from two half-set images.

Two images of interleaved halves of the sensors (:mod:`.half_images`) agree in the object, and differ in streaks and
noise. With a and b these images and ⟨·⟩ the mean over a Gaussian neighbourhood, ⟨ab⟩ is the local power of the common
part, and ⟨((a + b)/2)²⟩ that of the mean image. The image of all sensors is multiplied by

    w = max(0, ⟨ab⟩) / ⟨((a + b)/2)²⟩, at most 1,

the Wiener filter of electron microscopy's half maps, in space instead of frequency. Nothing is trained, and nothing is
added: weak structures below the artefacts around them are lost with these.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck
from steradian.core.quantity_ranges import LENGTH
from steradian.imaging import validation as checks
from steradian.imaging._reconstruct import reconstruct
from steradian.imaging.acquisition import Acquisition
from steradian.imaging.engines.array_namespace import to_numpy
from steradian.imaging.geometry.polygons import Outline
from steradian.imaging.geometry.sensor_areas import sensed_region
from steradian.imaging.half_images import half_images
from steradian.imaging.options import Compute, DirectMethod, ImageGrid, Nufft, require_direct
from steradian.imaging.volume import Volume

SMOOTHING = 1.5
"""Default width of the neighbourhood, in lateral voxels."""


def suppress_artefacts(
    acquisition: Acquisition,
    grid: ImageGrid,
    method: DirectMethod | None = None,
    *,
    smoothing: float | None = None,
    outline: Outline | None = None,
    compute: Compute | None = None,
    cancelled: CancelCheck | None = None,
) -> Volume:
    """Reconstruct directly, and suppress parts that the images of the sensors' halves do not have in common.

    For a quick look at a sparse scan, at the cost of four or five direct reconstructions; :class:`steradian.Iterative`
    is nearer to the object. Not for measuring: amplitudes beside strong structures change.

    Parameters
    ----------
    acquisition
        A-lines of 16 or more sensors (M, 2) in a plane.
    grid, method, compute
        As in :func:`steradian.reconstruct`; a direct method, None: NEDNER-NUFFT.
    smoothing
        Standard deviation of the neighbourhood in m; None: 1.5 lateral voxels.
    outline
        Region that the sensors cover, (K, 2) in m; None: found from the positions.
    cancelled
        Function asked between pieces of work.

    Returns
    -------
    Volume
        Its ``info.notes`` say what was done.

    Raises
    ------
    InvalidInput
        If there are fewer than 16 sensors, they are on a line, or a parameter is out of range.
    Cancelled
        If ``cancelled`` returned true.
    """
    method, compute = method or Nufft(), compute or Compute()
    require_direct(method, "; the filter is for direct methods")
    width = None if smoothing is None else LENGTH.check("smoothing", smoothing)
    positions, _, aperture = checks.resolve_sensors(acquisition.sensors, acquisition.weights, acquisition.aperture)
    positions = np.asarray(positions, np.float64)
    if positions.ndim != 2 or positions.shape[1] != 2:
        raise InvalidInput("sensors", "on a line", "in a plane")
    sides = checks.apertures(aperture, 2)
    plain = replace(acquisition, sensors=positions, weights=None, aperture=sides, traces=to_numpy(acquisition.traces))
    if outline is None:
        outline = sensed_region(positions, sides)
    first, second = half_images(plain, outline, grid, method, compute=compute, cancelled=cancelled)
    volume = reconstruct(acquisition, grid, method, compute=compute, cancelled=cancelled)
    if width is None:
        width = SMOOTHING * max(volume.spacing[:2])
    weights = wiener_weights(first, second, width)
    assert volume.info is not None  # noqa: S101 - of a reconstruction
    info = replace(volume.info, notes=(*volume.info.notes, _note(width, float(weights.mean()))))
    return replace(volume, values=to_numpy(volume.values) * weights, info=info)


def wiener_weights(first: Volume, second: Volume, smoothing: float) -> np.ndarray:
    """Return the weights w in 0 … 1 of each voxel from two half-set images; ``smoothing`` in m."""
    from scipy.ndimage import gaussian_filter

    a, b = (np.asarray(to_numpy(half.values), np.float32) for half in (first, second))
    largest = max(float(np.abs(a).max(initial=0)), float(np.abs(b).max(initial=0))) or 1.0
    a, b = a / np.float32(largest), b / np.float32(largest)  # squares stay within the range of float32
    *lateral, deep = (smoothing / step for step in first.spacing)
    together = max(1, int(deep))  # slices much closer than the neighbourhood is wide have one weight
    starts = np.arange(0, a.shape[-1], together)
    powers = (np.add.reduceat(v, starts, axis=-1) for v in (a * b, np.square(0.5 * (a + b))))
    common, total = (gaussian_filter(v, [*lateral, deep / together]) for v in powers)
    found = np.divide(common, total, out=np.zeros_like(common), where=total > 0)
    return np.repeat(np.clip(found, 0, 1), together, axis=-1)[..., : a.shape[-1]]


def _note(smoothing: float, mean: float) -> str:
    return (
        f"artefacts were suppressed by a half-set Wiener filter of {1e6 * smoothing:.3g} µm, mean weight {mean:.2g}: "
        "not for measuring"
    )
