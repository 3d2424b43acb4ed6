"""Explicit points: a mask from anywhere else."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from steradian.errors import InvalidInput
from steradian.masks.mask import Mask
from steradian.masks.weights import Weighting, weights_for
from steradian.ranges import LENGTH
from steradian.validation import FloatArray, Value, quantity


class Points(Value):
    """Explicit positions, with weights, with the areas of their Voronoi cells, or equally weighted."""

    arrangement: Literal["points"] = "points"
    aperture: float = quantity("m", "Side X of the square aperture", **LENGTH.limits)
    positions: FloatArray = Field(
        description="(M, 2) sensor positions x, y in metres, centred on the aperture; (M, 1) for a line"
    )
    weights: FloatArray | None = Field(default=None, description="(M,) relative weights, or none for equal ones")
    weighting: Weighting = Field(default="analytic", description="analytic: the weights given, equal if none are")

    @property
    def expected_count(self) -> int:
        """How many points the mask will have."""
        return len(self.positions)

    def build(self) -> Mask:
        """Normalise the weights and check the points.

        Raises
        ------
        InvalidInput
            When a point lies outside the aperture or the weights do not match the points.
        """
        relative = np.ones(len(self.positions)) if self.weights is None else self.weights
        if relative.shape != self.positions.shape[:1] or not len(relative):
            raise InvalidInput(
                "weights", f"an array of shape {relative.shape}", f"({len(self.positions)},), at least 1"
            )
        if (relative <= 0).any():
            raise InvalidInput("weights", f"{relative.min():g} at {int(relative.argmin())}", "> 0 (of any scale)")
        bare = Mask.create(  # checks the points before cells are drawn around them
            aperture=self.aperture,
            positions=self.positions,
            weights=relative * (self.aperture ** self.positions.shape[-1] / relative.sum()),
            arrangement={"arrangement": "points", "weighting": self.weighting},
        )
        return bare.replace(weights=weights_for(self.weighting, self.positions, self.aperture, relative))


def custom_mask(
    positions: ArrayLike,
    aperture: float,
    weights: ArrayLike | None = None,
    *,
    weighting: Weighting = "analytic",
) -> Mask:
    """Make a mask of explicit points.

    Parameters
    ----------
    positions
        (M, 2) positions x, y in metres, centred on the aperture; (M, 1) for a line.
    aperture
        Side X of the square aperture in metres.
    weights
        (M,) relative areas, or ``None`` for equal ones; scaled to sum to X².
    weighting
        ``analytic`` takes ``weights``, ``voronoi`` the areas of the points' cells, ``uniform`` equal shares.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.
    """
    return Points.create(aperture=aperture, positions=positions, weights=weights, weighting=weighting).build()
