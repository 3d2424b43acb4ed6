"""Rectangular grids, the usual arrangement of scanners."""

from __future__ import annotations

from typing import Literal

import numpy as np

from steradian.core.choices import Weighting
from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH
from steradian.core.validation import quantity_field
from steradian.imaging.geometry import polygons as outlines
from steradian.masks.arrangement_base import ArrangementBase
from steradian.masks.mask import Mask
from steradian.masks.weights import weights_for

PER_AXIS = "Points on each axis; the mask has their square, which is what --count of the command line means"


class Grid(ArrangementBase):
    """Parameters of a square grid of points."""

    arrangement: Literal["grid"] = "grid"
    count: int = quantity_field("points", PER_AXIS, ge=1, le=4096)
    interval: float = quantity_field("m", "Distance between neighbours", **LENGTH.limits)
    centred: bool = False
    """Whether an even grid is symmetric to the centre too; else it lies on −n/2 … n/2−1 intervals, like FFT modes."""
    weighting: Weighting = "analytic"

    @property
    def expected_count(self) -> int:
        """Number of points of the mask."""
        return self.count**2

    def build(self) -> Mask:
        """Build the grid mask.

        Raises
        ------
        InvalidInput
            When the grid is wider than the aperture.
        """
        if self.count * self.interval > self.aperture * (1 + 1e-9):
            raise InvalidInput(
                "interval", f"{self.interval:g}", f"at most aperture / count = {self.aperture / self.count:g} (m)"
            )
        middle = (self.count - 1) / 2 if self.centred else self.count // 2
        steps = (np.arange(self.count) - middle) * self.interval
        x, y = np.meshgrid(steps, steps, indexing="ij")
        positions = np.column_stack([x.ravel(), y.ravel()])
        half = np.full(2, self.interval / 2)
        outline = outlines.rectangle(positions[0] - half, positions[-1] + half)
        return Mask.create(
            aperture=self.aperture,
            positions=positions,
            weights=weights_for(self.weighting, positions, outline, np.ones(len(positions))),
            outline=outline,
            **self._fields_of_mask(),
        )


def grid_mask(
    aperture: float,
    count: int,
    interval: float,
    *,
    depth: float | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
    centred: bool = False,
    weighting: Weighting = "analytic",
) -> Mask:
    """Return a mask of ``count`` × ``count`` points on a square grid.

    Parameters
    ----------
    aperture
        Side X of the square aperture in metres.
    count
        Points on each axis.
    interval
        Distance between neighbours in metres.
    depth, offset
        Of the point of interest in metres that the mask is judged for; the points do not depend on it.
    centred
        An odd count is always symmetric to the centre. An even one lies on −n/2 … n/2−1 intervals, where the modes
        of an FFT are, or symmetric if this is set.
    weighting
        All the same here: each point stands for its cell of interval × interval, and the grid senses the square of
        count × interval that these fill.

    Returns
    -------
    Mask
        Points with x slowest.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.

    Examples
    --------
    >>> grid_mask(aperture=13.56e-3, count=41, interval=300e-6).count
    1681
    """
    return Grid.create(
        aperture=aperture,
        count=count,
        interval=interval,
        depth=depth,
        offset=offset,
        centred=centred,
        weighting=weighting,
    ).build()
