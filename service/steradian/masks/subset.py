"""Subset of an existing mask by point indices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import Field

from steradian.core.choices import Weighting
from steradian.core.exceptions import InvalidInput
from steradian.core.validation import Value
from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.sensor_areas import sensed_region
from steradian.masks.mask import Mask
from steradian.masks.weights import resolve_outline, weights_for


class Subset(Value):
    """Parameters of a subset of a mask: the mask and the indices of its points."""

    arrangement: Literal["subset"] = "subset"
    mask: Mask
    indices: tuple[int, ...] = Field(min_length=1, description="Indices of the points to keep, from 0; each once")
    weighting: Weighting = Field(default="voronoi", description="analytic: the mask's own weights, scaled")

    @property
    def expected_count(self) -> int:
        """Number of points of the mask."""
        return len(self.indices)

    def build(self) -> Mask:
        """Build the mask of the selected points.

        Raises
        ------
        InvalidInput
            When a number is out of range or occurs twice.
        """
        picked = np.asarray(self.indices)
        wrong = np.flatnonzero((picked < 0) | (picked >= self.mask.count))
        if len(wrong):
            raise InvalidInput(f"indices[{wrong[0]}]", picked[wrong[0]], f"0 to {self.mask.count - 1}")
        if len(np.unique(picked)) != len(picked):
            raise InvalidInput("indices", "a number that occurs twice", "each number once")
        positions = self.mask.positions[picked]
        # what the points that are left cover, as far as the mask did
        outline = outlines.intersection(sensed_region(positions, self.mask.aperture), resolve_outline(self.mask))
        return self.mask.replace(
            positions=positions,
            weights=weights_for(self.weighting, positions, outline, self.mask.weights[picked]),
            outline=outline,
            arrangement={
                "arrangement": "subset",
                "of": self.mask.id,
                "indices": picked.tolist(),
                "weighting": self.weighting,
            },
        )


def subset_mask(mask: Mask, indices: Sequence[int], *, weighting: Weighting = "voronoi") -> Mask:
    """Return a mask of selected points of another mask.

    Parameters
    ----------
    mask
        The mask to take them from.
    indices
        Their numbers, from 0; each once. The new mask has their order.
    weighting
        ``voronoi``: areas of the cells of the points that are left; ``analytic``: the mask's own weights, scaled;
        ``uniform``. They sum to what the points left sense: all within half their mean spacing of their hull, as far
        as the mask did.

    Raises
    ------
    InvalidInput
        Naming the index that is out of range or occurs twice.
    """
    return Subset.create(mask=mask, indices=tuple(map(int, indices)), weighting=weighting).build()


def nearest_points(existing: Mask, wanted: Mask) -> tuple[int, ...]:
    """Return the indices of the existing points nearest to requested ones, each once, in their order.

    With :func:`subset_mask` this answers what a sparse mask would have seen in a scan that was dense.

    Raises
    ------
    InvalidInput
        When one is a line and the other is not.
    """
    from scipy.spatial import KDTree

    if existing.is_line != wanted.is_line:
        raise InvalidInput("wanted", "a line and a plane", "two masks of the same kind")
    _, nearest = KDTree(existing.positions).query(wanted.positions)
    return tuple(dict.fromkeys(int(index) for index in np.asarray(nearest)))
