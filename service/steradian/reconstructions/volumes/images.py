"""Rendering of maximum-intensity projections as PNG images."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.drawing.canvas import ColourBar
from steradian.drawing.image_figure import ImageFigure, Layout
from steradian.drawing.style import colours, depth_colours
from steradian.drawing.ticks import Axis as Scale
from steradian.imaging import Volume
from steradian.imaging.signal.conditioning import Display
from steradian.reconstructions.volumes.near_field import crop_depth
from steradian.reconstructions.volumes.projections import Axis, project

__all__ = ["PLANE_LABELS", "Axis", "draw_depth_coded", "draw_mip", "draw_projection"]

PLANE_LABELS: dict[Axis, tuple[Axis, Axis]] = {"x": ("y", "z"), "y": ("x", "z"), "z": ("x", "y")}
"""The two axes that a projection along the third one shows, across and up (depth points down)."""

LINEAR = Display()
MIN_RANGE_SHARE, LEAST_DECIBELS = 0.5, 6.0
"""The scale never ends below half the maximum: a small object alone in a large field keeps its shape."""
LEAST_SCALE = 1e-3
"""Decibels: a maximum no higher above the scale's lowest value is rounding."""
SATURATED_SHARE = 0.5
"""Depths are coloured over those at which columns of at least this share of the brightness have their maximum."""


def draw_mip(volume: Volume, axis: Axis, path: Path, display: Display = LINEAR) -> Layout:
    """Draw the maximum-intensity projection of a volume along ``axis`` as a PNG (atomic write).

    Negative values, which a limited view and the record's finite band leave, are shown black.

    Parameters
    ----------
    volume
        The image, with ``display`` applied.
    axis
        The axis to project along; of an image [x, z] from a line of sensors, ``y`` shows the image itself.
    path
        Where to.
    display
        What was applied: whether values are decibels, and down to how many; and how to draw. Its near field is left
        out; none is where it is ``None``, for it is found with the sensors' positions
        (:func:`steradian.reconstructions.volumes.near_field.near_field_depth`).

    Returns
    -------
    Layout
        Where image and labels lie, and the value at the end of the scale.
    """
    shown = crop_depth(volume, display.near_field or 0.0)
    return draw_projection(project(shown)[axis], shown, axis, path, display)


def draw_projection(
    projected: NDArray[Any], volume: Volume, axis: Axis, path: Path, display: Display = LINEAR
) -> Layout:
    """Draw a precomputed projection as a PNG, like :func:`draw_mip`."""
    across, up = PLANE_LABELS[axis]
    lowest, highest, ending = display_range(projected, display)
    label = "initial pressure (dB of its maximum)" if lowest else "initial pressure (arb. u.)"
    bar = ColourBar(colours(display.colour_map)[::-1], Scale(highest, lowest, label), bool(ending))
    image = projected.T[::-1] if up == "y" else projected.T  # y points up, depth down from the sensor plane
    share = np.clip((image - lowest) * (255 / (highest - lowest)), 0, 255).astype(np.uint8)
    title = f"Maximum-intensity projection along {axis}" if volume.dimensions == 3 else "Image below the line"
    return _sheet(volume, (across, up), colours(display.colour_map)[share], title, ending, bar, display).save(path)


def draw_depth_coded(volume: Volume, path: Path, display: Display = LINEAR) -> Layout:
    """Draw the z-projection as a PNG with the depth of each maximum as colour and its value as brightness.

    Parameters
    ----------
    volume
        The 3-D image, with ``display`` applied.
    path
        Where to; a PNG, under a temporary name first.
    display
        What was applied; decibels are black at their least value. See :func:`draw_mip`.

    Raises
    ------
    InvalidInput
        For an image from a line of sensors, which has no columns to look down.
    """
    if volume.dimensions != 3:
        raise InvalidInput("volume", "an image [x, z]", "a volume [x, y, z]")
    shown = crop_depth(volume, display.near_field or 0.0)
    # plane by plane, so that each is looked at twice while it is in the cache
    places = np.stack([plane.argmax(axis=1) for plane in shown.values])
    projected = np.take_along_axis(shown.values, places[..., None], axis=2)[..., 0]
    lowest, highest, ending = display_range(projected, display)
    brightness = np.clip((projected - lowest) / (highest - lowest), 0, 1)
    depths = 1e3 * shown.axes.z[places]
    first, last = _depth_span(depths[brightness >= SATURATED_SHARE], 1e3 * shown.spacing[2])
    hues = depth_colours()[np.clip((depths - first) * (255 / (last - first)), 0, 255).astype(np.uint8)]
    image = (hues * brightness[..., None]).astype(np.uint8)
    bar = ColourBar(depth_colours(), Scale(first, last, "z, depth of the maximum (mm)"))
    title = "Maximum-intensity projection along z, coloured by depth"
    pixels = np.ascontiguousarray(image.transpose(1, 0, 2)[::-1])
    return _sheet(shown, ("x", "y"), pixels, title, ending, bar, display).save(path)


def display_range(projected: NDArray[Any], display: Display) -> tuple[float, float, str]:
    """Return lowest and highest value of the colour scale, and a text if the scale ends below the maximum."""
    lowest = -display.log_range_db if display.log_range_db else 0.0
    top = float(projected.max())
    least = top - LEAST_DECIBELS if display.log_range_db else MIN_RANGE_SHARE * top
    wanted = min(top, float(np.percentile(projected, display.percentile)))
    highest = max(wanted, least, lowest + 1e-30)
    if lowest and highest < lowest + LEAST_SCALE:  # an image of nothing
        highest = 0.0
    ending = "half the maximum" if wanted < least else f"the {display.percentile:g}th percentile"
    return lowest, highest, f"scale to {ending}" if highest < top else ""


def _depth_span(depths: NDArray[np.float64], step: float) -> tuple[float, float]:
    """Return the first and last depth of the colour scale: the 1st and 99th percentile of the depths."""
    first, last = np.percentile(depths, [1, 99]) if depths.size else (0.0, 0.0)
    return float(first), float(max(last, first + step))


def _sheet(
    volume: Volume,
    plane: tuple[Axis, Axis],
    pixels: NDArray[np.uint8],
    title: str,
    ending: str,
    bar: ColourBar,
    display: Display,
) -> ImageFigure:
    """Create the figure of a projection with title, axes and colour bar; ``display`` gives the longest side."""
    across, up = plane
    spans = [extent_mm(volume, name) for name in plane]
    scale = display.size / max(last - first for first, last in spans)
    width, height = (max(1, round((last - first) * scale)) for first, last in spans)
    nearest = float(volume.axes.z[0])
    remarks = [f"from {1e3 * nearest:.2f} mm depth"] if nearest > volume.spacing[-1] / 2 else []
    remarks += [ending] if ending else []
    return ImageFigure(
        pixels,
        width,
        height,
        title,
        ", ".join(remarks),
        Scale(*spans[0], f"{across} (mm)"),
        Scale(*(spans[1] if up == "z" else spans[1][::-1]), f"{up} (mm)" if up == "y" else "z, depth (mm)"),
        bar,
        None if display.scale_bar is None else 1e3 * display.scale_bar,
    )


def extent_mm(volume: Volume, name: str) -> tuple[float, float]:
    """Return the positions of the outer voxel edges along an axis, in mm."""
    places = 1e3 * volume.coordinates(name)
    half = 0.5e3 * volume.spacing[volume.names.index(name)]
    return float(places[0] - half), float(places[-1] + half)
