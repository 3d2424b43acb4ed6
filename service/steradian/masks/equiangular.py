"""Equiangular lines: sensors at equal angles seen from the point of interest, for 2-D (paper, section 4.1)."""

from __future__ import annotations

from math import atan
from typing import Literal

import numpy as np
from pydantic import Field

from steradian.core.choices import Weighting
from steradian.core.quantity_ranges import LENGTH
from steradian.core.validation import Value, quantity_field
from steradian.imaging.geometry import polygons as outlines
from steradian.masks.arrangement_base import check_offset
from steradian.masks.mask import Mask
from steradian.masks.scanner_grid import ScannerGrid
from steradian.masks.weights import expand_outline, weights_for


class Equiangular(Value):
    """Parameters of a line of sensors at equal angles seen from the point of interest."""

    arrangement: Literal["equiangular"] = "equiangular"
    aperture: float = quantity_field("m", "Length X of the line", **LENGTH.limits)
    depth: float = quantity_field("m", "Distance r0 of the point of interest from the line", **LENGTH.limits)
    count: int = quantity_field("points", "Number of sensors", ge=2, le=1_000_000)
    offset: float = Field(default=0.0, description="x of the point of interest, centred on the line (m)")
    grid: ScannerGrid | None = Field(default=None, description="Places where the scanner can stop, if not anywhere")
    weighting: Weighting = "voronoi"

    @property
    def expected_count(self) -> int:
        """Approximate number of sensors of the mask."""
        return self.count

    def build(self) -> Mask:
        """Build the line of sensors; fewer than ``count`` if several snap to the same position.

        Raises
        ------
        InvalidInput
            When the point of interest is not over the line.
        """
        check_offset((self.offset, 0.0), self.aperture)
        half = self.aperture / 2
        left, right = (atan((side - self.offset) / self.depth) for side in (-half, half))
        positions = (self.offset + self.depth * np.tan(np.linspace(left, right, self.count)))[:, None]
        positions = np.clip(positions, -half, half)
        weights = (positions[:, 0] - self.offset) ** 2 + self.depth**2  # paper, section 4.2: h ∝ r²
        if self.grid is not None:
            positions, weights = self.grid.snap(positions, weights)
        outline = expand_outline(outlines.rectangle((-half,), (half,)), positions)
        return Mask.create(
            aperture=self.aperture,
            depth=self.depth,
            offset=(self.offset, 0.0),
            positions=positions,
            weights=weights_for(self.weighting, positions, outline, weights),
            outline=outline,
            arrangement=self.model_dump(mode="json"),
        )


def equiangular_mask(
    aperture: float,
    depth: float,
    count: int,
    *,
    offset: float = 0.0,
    grid: ScannerGrid | None = None,
    weighting: Weighting = "voronoi",
) -> Mask:
    """Return a line of sensors whose neighbours enclose the same angle seen from the point of interest.

    Parameters
    ----------
    aperture
        Length X of the line in metres.
    depth
        Distance r0 of the point of interest from the line in metres.
    count
        Number of sensors; the outermost sit on the ends of the line.
    offset
        x of the point of interest in metres, centred on the line.
    grid
        Places where the scanner can stop; sensors that meet on one are merged.
    weighting
        ``voronoi``: half the way to each neighbour, the outermost sensors' as far as the line; ``analytic``: the
        paper's h ∝ r², which gives the outermost twice as much and takes it from all; ``uniform``.

    Returns
    -------
    Mask
        Positions (M, 1), left to right; weights are lengths that sum to X.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.

    Examples
    --------
    >>> grid = ScannerGrid(count=1024, interval=1e-4)
    >>> mask = equiangular_mask(1024e-4, 128e-4, 32, grid=grid, weighting="analytic")
    >>> mask.positions.shape, 16 < mask.weight_ratio < 18
    ((32, 1), True)
    """
    return Equiangular.create(
        aperture=aperture, depth=depth, count=count, offset=offset, grid=grid, weighting=weighting
    ).build()
