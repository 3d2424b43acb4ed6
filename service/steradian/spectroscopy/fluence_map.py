"""Fluence from a simulation or measurement, on voxels of its own or on those of the series."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.volume import VoxelAxes

Floats = NDArray[np.float64]
SAME_WAVELENGTH = 0.5e-9
"""Distance in m below which two wavelengths are one."""


@dataclass(frozen=True, eq=False)
class FluenceMap:
    """Fluence from a simulation or measurement.

    Parameters
    ----------
    values
        Relative fluence, broadcastable to (wavelengths, x, y, z), above 0.
    wavelengths
        Wavelengths of the first axis in m, in any order; (): those of the series in its order.
    axes
        Voxels of the map, which must contain the volumes of the series; None: the voxels of the series. The
        logarithm is interpolated linearly between voxels, which is exact for an exponential decay.
    """

    values: Floats
    wavelengths: tuple[float, ...] = ()
    axes: VoxelAxes | None = None

    def relative(self, wavelengths: Floats, axes: VoxelAxes) -> Floats:
        """Return the fluence on the voxels of the series.

        Raises
        ------
        InvalidInput
            When the shape does not fit, a value is not above 0, a wavelength is missing, or the map is too small.
        """
        values = np.asarray(self.values, np.float64)
        if values.ndim != 4:
            raise InvalidInput("fluence", f"an array of shape {values.shape}", "4 axes: wavelengths, x, y, z")
        if not (np.isfinite(values) & (values > 0)).all():
            raise InvalidInput("fluence", f"minimum {np.nanmin(values):g}", "above 0 everywhere")
        if self.wavelengths:
            values = values[self._selected(wavelengths, len(values))]
        shape = (len(wavelengths), *_sides(axes))
        own = shape if self.axes is None else (len(wavelengths), *_sides(self.axes))
        if any(n not in (1, wanted) for n, wanted in zip(values.shape, own, strict=True)):
            raise InvalidInput("fluence", f"an array of shape {values.shape}", f"shape {own}, or 1 along an axis")
        return values if self.axes is None else self._interpolated(values, self.axes, axes)

    def _selected(self, wavelengths: Floats, count: int) -> list[int]:
        """Return the places of the wanted wavelengths along the first axis."""
        if count not in (1, len(self.wavelengths)):
            raise InvalidInput("fluence", f"{count} maps", f"{len(self.wavelengths)}, one for each wavelength")
        own, places = np.asarray(self.wavelengths, np.float64), []
        for light in wavelengths:
            nearest = int(np.abs(own - light).argmin())
            if abs(own[nearest] - light) >= SAME_WAVELENGTH:
                allowed = ", ".join(f"{1e9 * each:g}" for each in own)
                raise InvalidInput("fluence", f"no map for {1e9 * light:g} nm", f"wavelengths of the map: {allowed} nm")
            places.append(nearest if count > 1 else 0)
        return places

    def _interpolated(self, values: Floats, own: VoxelAxes, wanted: VoxelAxes) -> Floats:
        """Return the map on other voxels, along one axis after the other."""
        logarithm = np.log(values)
        for axis, name in enumerate("xyz", start=1):
            have, want = getattr(own, name), getattr(wanted, name)
            if logarithm.shape[axis] == 1 or want is None:
                continue
            step = float(np.diff(have).max())
            if want[0] < have[0] - step / 2 or want[-1] > have[-1] + step / 2:
                allowed = f"at least {1e3 * want[0]:g} to {1e3 * want[-1]:g} mm, the volumes of the series"
                raise InvalidInput("fluence", f"{name} from {1e3 * have[0]:g} to {1e3 * have[-1]:g} mm", allowed)
            place = np.interp(want, have, np.arange(len(have)))
            low = np.minimum(place.astype(np.int64), len(have) - 2)
            share = (place - low).reshape([-1 if other == axis else 1 for other in range(4)])
            logarithm = (1 - share) * logarithm.take(low, axis) + share * logarithm.take(low + 1, axis)
        return np.asarray(np.exp(logarithm))


def _sides(axes: VoxelAxes) -> tuple[int, int, int]:
    return len(axes.x), 1 if axes.y is None else len(axes.y), len(axes.z)
