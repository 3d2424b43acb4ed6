"""Panels of figures and films: projections with their axes and names, and the colour scale that they share."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import as_finite_float
from steradian.imaging import Volume, VoxelAxes
from steradian.reconstructions.volumes.images import PLANE_LABELS, Axis, extent_mm

Floats = NDArray[np.float64]
BRIGHT = 0.5
"""Share of the scale from which a column's depth counts for the range of colours."""
MOST_PANELS = 36
Span: TypeAlias = tuple[float, float]
HUES = {
    "red": (1, 0, 0),
    "green": (0, 1, 0),
    "blue": (0, 0, 1),
    "cyan": (0, 1, 1),
    "magenta": (1, 0, 1),
    "yellow": (1, 1, 0),
}
"""Colours (red, green, blue) of maps from black to one colour."""
SIGNED = ("coolwarm", "RdBu", "RdBu_r", "bwr", "seismic")
"""Colour maps with a zero in their middle."""


class OutsideVolume(InvalidInput):
    """Error: the part to show lies outside of the volume."""


@dataclass(frozen=True, eq=False)
class Panel:
    """Projection of a volume, ready to draw.

    Parameters
    ----------
    image
        Values [up, across], first row at the lower edge; NaN where there is no value.
    depths
        Depth in mm of each pixel's maximum, in the same order.
    across, up
        First and last edge of the axes in mm, from left to right and from bottom to top.
    labels
        Labels of both axes.
    name
        Title; "" for none.
    """

    image: Floats
    depths: Floats
    across: tuple[float, float]
    up: tuple[float, float]
    labels: tuple[str, str]
    name: str = ""

    @classmethod
    def of(
        cls,
        volume: Volume,
        axis: Axis = "z",
        name: str = "",
        near_field: float = 0.0,
        slab: Span | None = None,
        region: Mapping[str, Span] | None = None,
    ) -> Panel:
        """Return the projection of a volume along an axis; the image itself of a line of sensors.

        Parameters
        ----------
        volume
            The image.
        axis
            Axis that disappears.
        name
            Title.
        near_field
            Depth in m above which the image is left out; a slab along z has its own.
        slab
            First and last position in m along the axis that disappears: the maximum between them, of one position
            the nearest slice; None: all.
        region
            First and last position in m that is shown, by axis; all of those that are not named.

        Raises
        ------
        InvalidInput
            If there is no such axis, nothing below that depth, or a range does not rise or lies outside.
        """
        if axis not in PLANE_LABELS:
            raise InvalidInput("axis", axis, ", ".join(PLANE_LABELS))
        if not near_field <= volume.axes.z[-1] + 1e-9:
            raise InvalidInput("near_field", near_field, f"at most {volume.axes.z[-1]:.6g} m, the last depth")
        if volume.dimensions == 2:
            axis, slab = "y", None
        ranges: dict[str, Span] = (
            {} if region is None else {key: span for key, span in region.items() if key in PLANE_LABELS[axis]}
        )
        if axis != "z" or slab is None:
            first, last = ranges.get("z", (-np.inf, np.inf))
            ranges["z"] = (max(first, near_field), last)
        if slab is not None:
            ranges[axis] = slab
        volume = _cropped(volume, ranges)
        values, depths = np.asarray(volume.values), 1e3 * volume.axes.z
        if volume.dimensions == 2:
            image, places = values.astype(np.float64), np.broadcast_to(depths, values.shape)
        else:
            number = volume.names.index(axis)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # columns without any value stay NaN
                image = np.nanmax(values, axis=number).astype(np.float64)
            if axis == "z":
                filled = np.stack([np.nan_to_num(plane, nan=-np.inf).argmax(axis=1) for plane in values])
                places = depths[filled]
            else:
                places = np.broadcast_to(depths, image.shape)
        across, up = PLANE_LABELS[axis]
        first, last = extent_mm(volume, up)[:: -1 if up == "z" else 1]
        turned, deep = (np.asarray(each.T if up != "z" else each.T[::-1]) for each in (image, places))
        text = f"{up} (mm)" if up != "z" else "z, depth (mm)"
        return cls(turned, deep, extent_mm(volume, across), (first, last), (f"{across} (mm)", text), name)


def _cropped(volume: Volume, ranges: Mapping[str, Span]) -> Volume:
    """Return the part of a volume whose voxel centres lie in ranges (m) by axis; where none does, the nearest voxel."""
    parts: list[slice] = []
    for name in volume.names:
        places = volume.coordinates(name)
        first, last = ranges.get(name, (-np.inf, np.inf))
        half = volume.spacing[volume.names.index(name)] / 2
        if not (first <= last and first <= places[-1] + half and last >= places[0] - half):
            allowed = f"{places[0]:.6g} to {places[-1]:.6g} m, the first not above the second"
            raise OutsideVolume(f"range along {name}", f"{first:g} to {last:g}", allowed)
        inside = np.flatnonzero((places >= first - 1e-9) & (places <= last + 1e-9))
        if inside.size:
            parts.append(slice(int(inside[0]), int(inside[-1]) + 1))
        else:
            nearest = int(np.abs(places - (first + last) / 2).argmin())
            parts.append(slice(nearest, nearest + 1))
    lines = dict(zip(volume.names, parts, strict=True))
    y = None if volume.axes.y is None else volume.axes.y[lines["y"]]
    axes = VoxelAxes(volume.axes.x[lines["x"]], y, volume.axes.z[lines["z"]])
    return Volume(np.asarray(volume.values)[tuple(parts)], axes, volume.spacing, volume.sound_speed)


def colour_table(name: str) -> Floats:
    """Return the colours (256, 3), 0 to 1, of a colour map of matplotlib, or from black to one of :data:`HUES`.

    Raises
    ------
    InvalidInput
        If there is no such colour map.
    """
    from matplotlib import colormaps

    share = np.arange(256) / 255
    if name in HUES:
        return share[:, None] * np.array(HUES[name], np.float64)
    if name not in colormaps:
        raise InvalidInput("colour_map", name, f"a colour map of matplotlib, such as inferno, or {', '.join(HUES)}")
    return np.asarray(colormaps[name](share)[:, :3], np.float64)


@dataclass(frozen=True)
class ColourScale:
    """Colour scale of panels.

    Parameters
    ----------
    lowest, highest
        Values at its ends.
    label
        Quantity and unit.
    colour_map
        Name of a colour map of matplotlib.
    depth_span
        First and last depth in mm, where colours are depths and the values brightness; None: colours are values.
    gamma
        Exponent of the share of the scale; below 1 brightens.
    log_range_db
        Range of a logarithmic scale in dB below its upper end, instead of the exponent; None: not logarithmic.
    """

    lowest: float
    highest: float
    label: str
    colour_map: str
    depth_span: tuple[float, float] | None = None
    gamma: float = 1.0
    log_range_db: float | None = None

    @classmethod
    def of(
        cls,
        panels: Sequence[Panel],
        *,
        limits: tuple[float, float] | None = None,
        percentile: float = 99.9,
        label: str = "initial pressure (arb. u.)",
        colour_map: str = "inferno",
        depth_coded: bool = False,
        gamma: float = 1.0,
        log_range_db: float | None = None,
        most: int = MOST_PANELS,
    ) -> ColourScale:
        """Return the scale of all panels: from 0 to the greatest of their percentiles, unless limits are given.

        Raises
        ------
        InvalidInput
            If limits do not rise, the percentile is not 50 to 100, there is no such colour map, or no panel, or
            the exponent or range is out of range.
        """
        if not 1 <= len(panels) <= most:
            raise InvalidInput("volumes", len(panels), f"1 to {most}")
        colour_table(colour_map)
        if not 0.1 <= as_finite_float("gamma", gamma, "0.1 to 5") <= 5:
            raise InvalidInput("gamma", gamma, "0.1 to 5")
        if log_range_db is not None and not 10 <= as_finite_float("log_range_db", log_range_db, "10 to 80 dB") <= 80:
            raise InvalidInput("log_range_db", log_range_db, "10 to 80 dB")
        if not 50 <= as_finite_float("percentile", percentile, "50 to 100") <= 100:
            raise InvalidInput("percentile", percentile, "50 to 100")
        if limits is None:
            tops = [np.nanpercentile(each.image, percentile) for each in panels if np.isfinite(each.image).any()]
            lowest, highest = 0.0, max([float(top) for top in tops], default=0.0) or 1.0
        else:
            lowest, highest = map(float, limits)
        if not (np.isfinite([lowest, highest]).all() and lowest < highest):
            raise InvalidInput("limits", f"{lowest:g} to {highest:g}", "two numbers that rise")
        span = None
        if depth_coded:
            bright = [each.depths[each.image >= lowest + BRIGHT * (highest - lowest)].ravel() for each in panels]
            every = np.concatenate(bright)
            first, last = np.percentile(every, [1, 99]) if every.size else (0.0, 1.0)
            span = (float(first), float(max(last, first + 0.05)))
        return cls(lowest, highest, label, colour_map, span, float(gamma), log_range_db)

    def share(self, image: Floats) -> Floats:
        """Return values as a share of the colours, 0 to 1; NaN stays.

        Of a colour map with a zero in its middle, exponent and logarithm act to either side of it.
        """
        share = np.asarray(np.clip((image - self.lowest) / (self.highest - self.lowest), 0, 1))
        if self.colour_map in SIGNED and self.depth_span is None:
            return np.asarray(0.5 + 0.5 * np.sign(share - 0.5) * self._transfer(np.abs(2 * share - 1)))
        return self._transfer(share)

    def _transfer(self, share: Floats) -> Floats:
        if self.log_range_db:
            return np.asarray(np.maximum(0, 1 + 20 / self.log_range_db * np.log10(np.maximum(share, 1e-9))))
        return np.asarray(share**self.gamma)

    def paint(self, panel: Panel) -> NDArray[np.uint8]:
        """Return the colours (up, across, 3) of a panel, grey for missing values."""
        from steradian.drawing.style import depth_colours

        share = self.share(panel.image)
        filled = np.nan_to_num(share)
        if self.depth_span is None:
            painted = 255 * colour_table(self.colour_map)[np.minimum(256 * filled, 255).astype(np.uint8)]
        else:
            first, last = self.depth_span
            place = np.clip((panel.depths - first) * (255 / (last - first)), 0, 255).astype(np.uint8)
            painted = depth_colours()[place] * filled[..., None]
        return np.where(np.isnan(share)[..., None], 200, np.round(painted)).astype(np.uint8)
