"""Explicit points: a mask from anywhere else."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from steradian.masks.mask import Mask
from steradian.validation import FloatArray, Value, quantity


class Points(Value):
    """Explicit positions, with weights or equally weighted."""

    arrangement: Literal["points"] = "points"
    aperture: float = quantity("m", "Side X of the square aperture", gt=0, le=1)
    positions: FloatArray = Field(description="(M, 2) sensor positions x, y in metres, centred on the aperture")
    weights: FloatArray | None = Field(default=None, description="(M,) relative weights, or none for equal ones")

    def build(self) -> Mask:
        """Normalise the weights and check the points.

        Raises
        ------
        InvalidInput
            When a point lies outside the aperture or the weights do not match the points.
        """
        relative = np.ones(len(self.positions)) if self.weights is None else self.weights
        total = float(relative.sum())
        return Mask.create(
            aperture=self.aperture,
            positions=self.positions,
            weights=relative * (self.aperture**2 / total) if total > 0 else relative,
            arrangement={"arrangement": "points"},
        )


def custom_mask(positions: ArrayLike, aperture: float, weights: ArrayLike | None = None) -> Mask:
    """Make a mask of explicit points.

    Parameters
    ----------
    positions
        (M, 2) positions x, y in metres, centred on the aperture.
    aperture
        Side X of the square aperture in metres.
    weights
        (M,) relative areas, or ``None`` for equal ones; scaled to sum to X².

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.
    """
    return Points.create(aperture=aperture, positions=positions, weights=weights).build()
