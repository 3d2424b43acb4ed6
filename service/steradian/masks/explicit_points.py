"""Masks of explicit points, for example those of another program."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from steradian.core.choices import Weighting
from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH
from steradian.core.validation import FloatArray, Value, quantity_field
from steradian.imaging.geometry.sensor_areas import sensed_region
from steradian.imaging.validation import MAX_AREA_RATIO
from steradian.masks.mask import Mask, check_shape
from steradian.masks.weights import weights_for


class Points(Value):
    """Parameters of explicit positions with given, Voronoi or equal weights.

    ``sensed_area`` is for weights that are given.
    """

    arrangement: Literal["points"] = "points"
    aperture: float = quantity_field("m", "Side X of the square aperture", **LENGTH.limits)
    positions: FloatArray = Field(
        description="(M, 2) sensor positions x, y in metres, centred on the aperture; (M, 1) for a line"
    )
    weights: FloatArray | None = Field(
        default=None, description="(M,) areas of any scale, scaled to the sensed area; none: those of the points' cells"
    )
    sensed_area: float | None = quantity_field(
        "m^2, m for a line", "Sum of the weights; none: computed from the points", gt=0, le=4, default=None
    )
    weighting: Weighting = Field(
        default="analytic", description="analytic: the weights given, those of the points' cells if none are"
    )

    @property
    def expected_count(self) -> int:
        """Number of points of the mask."""
        return len(self.positions)

    def build(self) -> Mask:
        """Build the mask: validate the points and normalise the weights.

        Raises
        ------
        InvalidInput
            When a point lies outside the aperture or the weights do not match the points.
        """
        check_shape(self.positions)
        relative = np.ones(len(self.positions)) if self.weights is None else self.weights
        if relative.shape != self.positions.shape[:1]:
            raise InvalidInput("weights", f"an array of shape {relative.shape}", f"({len(self.positions)},)")
        if (relative <= 0).any():
            raise InvalidInput("weights", f"{relative.min():g} at {int(relative.argmin())}", "> 0 (of any scale)")
        bare = Mask.create(  # checks the points before cells are drawn around them
            aperture=self.aperture,
            positions=self.positions,
            weights=relative * (self.aperture ** self.positions.shape[-1] / relative.sum()),
            arrangement={"arrangement": "points", "weighting": self.weighting},
        )
        given = self.weighting == "analytic" and self.weights is not None
        if given and self.sensed_area is not None:
            return bare.replace(weights=relative * (self.sensed_area / relative.sum()))
        outline = sensed_region(self.positions, self.aperture)
        rule = "voronoi" if self.weighting == "analytic" and not given else self.weighting
        return bare.replace(weights=weights_for(rule, self.positions, outline, relative), outline=outline)


def area_of_weights(total: float | None, aperture: float, axes: int) -> float | None:
    """Return the weights' sum in m² (m for one axis) if plausible as an area, else ``None`` (relative weights)."""
    return total if total is not None and 0 < total <= MAX_AREA_RATIO * aperture**axes else None


def custom_mask(
    positions: ArrayLike,
    aperture: float,
    weights: ArrayLike | None = None,
    *,
    weighting: Weighting = "analytic",
    sensed_area: float | None = None,
) -> Mask:
    """Return a mask of explicit points.

    Parameters
    ----------
    positions
        (M, 2) positions x, y in metres, centred on the aperture; (M, 1) for a line.
    aperture
        Side X of the square aperture in metres.
    weights
        (M,) areas of any scale, scaled to sum to the sensed area; ``None``: those of the points' cells.
    weighting
        ``analytic`` takes ``weights`` if there are any, ``voronoi`` the areas of the points' cells, ``uniform`` equal
        shares.
    sensed_area
        What ``weights`` sum to in m² (m for a line): their own sum where they are areas. ``None``: the area found from
        the points (:func:`steradian.imaging.geometry.sensor_areas.sensed_region`): that of a grid's cells, or all
        within half a mean spacing of the points' hull, no wider than the aperture.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.
    """
    return Points.create(
        aperture=aperture, positions=positions, weights=weights, weighting=weighting, sensed_area=sensed_area
    ).build()
