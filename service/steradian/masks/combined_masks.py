"""Masks that combine equi-steradian patterns for several points of interest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from steradian.core.choices import Weighting
from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH
from steradian.core.validation import Value, quantity_field
from steradian.imaging.geometry import polygons as outlines
from steradian.masks.equi_steradian import EquiSteradian, EquiSteradianPattern
from steradian.masks.mask import Mask
from steradian.masks.scanner_grid import ScannerGrid
from steradian.masks.weights import expand_outline, weights_for

MIN_SPACING_RATIO = 0.6
"""Where two patterns meet, points closer than this part of the expected spacing are thinned."""


class PointOfInterest(Value):
    """Point of interest of a combined mask, and its number of points."""

    depth: float = quantity_field("m", "Distance r0 from the sensor plane", **LENGTH.limits)
    count: int = quantity_field(
        "points", "Points that an equi-steradian mask for it alone would have", ge=5, le=1_000_000
    )
    offset: tuple[float, float] = Field(default=(0.0, 0.0), description="x and y, centred on the aperture (m)")


class Combined(Value):
    """Parameters of a mask that is equi-steradian around each of several points of interest.

    Every place of the aperture is sensed as densely as the most demanding point of interest asks there.
    """

    arrangement: Literal["combined"] = "combined"
    aperture: float = quantity_field("m", "Side X of the square aperture", **LENGTH.limits)
    points_of_interest: tuple[PointOfInterest, ...] = Field(
        min_length=1, max_length=64, description="1 to 64 points of interest"
    )
    grid: ScannerGrid | None = Field(default=None, description="Places where the scanner can stop, if not anywhere")
    weighting: Weighting = "voronoi"

    @property
    def expected_count(self) -> int:
        """Upper bound of the number of points of the mask."""
        return sum(point.count for point in self.points_of_interest)

    def build(self) -> Mask:
        """Build the combined mask.

        Raises
        ------
        InvalidInput
            When a point of interest is not over the aperture.
        """
        wanted = [self._around(number) for number in range(len(self.points_of_interest))]
        patterns = [each.pattern() for each in wanted]
        positions = _remove_close_points(
            np.concatenate([_dominant_region(patterns, index) for index in range(len(patterns))]), patterns
        )
        weights = _spacing(positions, patterns) ** 2
        if self.grid is not None:
            positions, weights = self.grid.snap(positions, weights)
        outline = expand_outline(outlines.convex_hull(np.concatenate([each.outline() for each in wanted])), positions)
        first = self.points_of_interest[0]
        return Mask.create(
            aperture=self.aperture,
            depth=first.depth,
            offset=first.offset,
            positions=positions,
            weights=weights_for(self.weighting, positions, outline, weights),
            outline=outline,
            arrangement=self.model_dump(mode="json"),
        )

    def _around(self, number: int) -> EquiSteradian:
        """Return the mask for one point of interest alone; errors name that point."""
        try:
            return EquiSteradian.create(aperture=self.aperture, **dict(self.points_of_interest[number]))
        except InvalidInput as error:
            raise InvalidInput(f"points_of_interest.{number}.{error.field}", error.value, error.allowed) from error


def _spacing(positions: NDArray[np.float64], patterns: Sequence[EquiSteradianPattern]) -> NDArray[np.float64]:
    """Return the expected distance between neighbours: that of the densest pattern at each position."""
    found: NDArray[np.float64] = np.min([pattern.spacing(positions) for pattern in patterns], axis=0)
    return found


def _dominant_region(patterns: Sequence[EquiSteradianPattern], index: int) -> NDArray[np.float64]:
    """Return the points of one pattern at which it is the densest."""
    positions = patterns[index].positions
    spacings = [pattern.spacing(positions) for pattern in patterns]
    own: NDArray[np.float64] = positions[np.argmin(spacings, axis=0) == index]
    return own


def _remove_close_points(
    positions: NDArray[np.float64], patterns: Sequence[EquiSteradianPattern]
) -> NDArray[np.float64]:
    """Remove the later of any two points that are too close; within one pattern there are none."""
    from scipy.spatial import KDTree

    if len(patterns) == 1:
        return positions
    spacing = MIN_SPACING_RATIO * _spacing(positions, patterns)
    pairs = KDTree(positions).query_pairs(float(spacing.max()), output_type="ndarray")
    apart = np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1)
    kept = np.ones(len(positions), bool)
    for earlier, later in np.sort(pairs[apart < spacing[pairs].min(axis=1)], axis=1):
        if kept[earlier]:
            kept[later] = False
    left: NDArray[np.float64] = positions[kept]
    return left


def combined_mask(
    aperture: float,
    points_of_interest: Sequence[PointOfInterest],
    *,
    grid: ScannerGrid | None = None,
    weighting: Weighting = "voronoi",
) -> Mask:
    """Return a mask that is equi-steradian around several points of interest.

    Parameters
    ----------
    aperture
        Side X of the square aperture in metres.
    points_of_interest
        Where to see well; at each place of the aperture the densest of their patterns is kept.
    grid
        Places where the scanner can stop; points that meet on one are merged.
    weighting
        ``voronoi``: cells within the hull of the points of interest's discs; ``analytic``: one over the density asked
        for; ``uniform``.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.

    Examples
    --------
    >>> left, right = (PointOfInterest(depth=2e-3, count=300, offset=(x, 0.0)) for x in (-3e-3, 3e-3))
    >>> combined_mask(13.56e-3, [left, right]).count < 700
    True
    """
    return Combined.create(
        aperture=aperture, points_of_interest=tuple(points_of_interest), grid=grid, weighting=weighting
    ).build()
