"""Overlay of a second volume in a figure: its colours are added to those of the first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import as_finite_float
from steradian.reconstructions.volumes.panels import ColourScale, Panel


@dataclass(frozen=True)
class Overlay:
    """Second volume of a figure, ready to draw.

    Parameters
    ----------
    panels
        Its projection of each axis along which it reaches the slices shown.
    scale
        Its colour scale.
    opacity
        Shares, 0 to 1, with which colours of the first and of the second volume are added.
    """

    panels: Mapping[tuple[str, str], Panel] = field(repr=False)
    scale: ColourScale
    opacity: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        for share in self.opacity:
            if not 0 <= as_finite_float("opacity", share, "0 to 1") <= 1:
                raise InvalidInput("opacity", share, "0 to 1")

    def paint(self, panel: Panel, colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the colours (up, across, 3) of a panel with those of the second volume added.

        Each pixel takes the nearest voxel of the second volume; beyond it, and where a value is missing, nothing is
        added.
        """
        other = self.panels.get(panel.labels)
        if other is None:
            return np.asarray(np.clip(np.round(self.opacity[0] * colours.astype(np.float64)), 0, 255), np.uint8)
        rows, inside_up = _nearest(panel.up, panel.image.shape[0], other.up, other.image.shape[0])
        columns, inside_across = _nearest(panel.across, panel.image.shape[1], other.across, other.image.shape[1])
        image = other.image[np.ix_(rows, columns)]
        there = inside_up[:, None] & inside_across & np.isfinite(image)
        placed = Panel(image, other.depths[np.ix_(rows, columns)], panel.across, panel.up, panel.labels)
        added = np.where(there[..., None], self.scale.paint(placed), 0)
        total = self.opacity[0] * colours.astype(np.float64) + self.opacity[1] * added
        return np.asarray(np.clip(np.round(total), 0, 255), np.uint8)


def _nearest(
    edges: tuple[float, float], count: int, other: tuple[float, float], others: int
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return for each pixel between edges the nearest pixel of another axis, and whether it lies within that."""
    places = edges[0] + (np.arange(count) + 0.5) / count * (edges[1] - edges[0])
    share = (places - other[0]) / (other[1] - other[0])
    return np.clip((share * others).astype(np.intp), 0, others - 1), (share >= 0) & (share <= 1)
