"""Uniform random and Poisson-disc arrangements."""

from __future__ import annotations

from math import sqrt
from typing import Literal, Self

import numpy as np
from pydantic import model_validator

from steradian.core.choices import Weighting
from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH
from steradian.core.validation import quantity_field
from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.polygons import Outline
from steradian.masks.arrangement_base import (
    COUNT_FIELD,
    MAX_POINTS,
    ArrangementBase,
    closeness_key,
    count_along_side,
    require_exactly_one,
)
from steradian.masks.mask import Mask
from steradian.masks.weights import weights_for

TRIES = 24
"""Spacings tried for a number of Poisson-disc points, after halving."""


class Random(ArrangementBase):
    """Parameters of independent, uniformly distributed points."""

    arrangement: Literal["random"] = "random"
    count: int = quantity_field("points", "Number of points", **COUNT_FIELD)
    seed: int = quantity_field("any", "The same seed gives the same points", ge=0, lt=2**63, default=0)
    weighting: Weighting = "voronoi"

    @property
    def expected_count(self) -> int:
        """Number of points of the mask."""
        return self.count

    def build(self) -> Mask:
        """Build the random mask."""
        positions = (np.random.default_rng(self.seed).random((self.count, 2)) - 0.5) * self.aperture
        return Mask.create(
            aperture=self.aperture,
            positions=positions,
            weights=weights_for(self.weighting, positions, _square(self.aperture), np.ones(self.count)),
            outline=_square(self.aperture),
            **self._fields_of_mask(),
        )


class PoissonDisc(ArrangementBase):
    """Parameters of Poisson-disc points: random, at least ``spacing`` apart, without gaps for another."""

    arrangement: Literal["poisson-disc"] = "poisson-disc"
    spacing: float | None = quantity_field("m", "Least distance between two points", default=None, **LENGTH.limits)
    count: int | None = quantity_field(
        "points",
        "Number of points instead of the spacing; a search approximates it",
        default=None,
        **COUNT_FIELD,
    )
    seed: int = quantity_field("any", "The same seed gives the same points", ge=0, lt=2**63, default=0)
    weighting: Weighting = "voronoi"

    @model_validator(mode="after")
    def _check(self) -> Self:
        require_exactly_one(count=self.count, spacing=self.spacing)
        return self

    @property
    def expected_count(self) -> int:
        """Approximate number of points: discs of the spacing's diameter cover 55 % of the plane."""
        return self.count or round(0.7 * count_along_side(self.aperture, self.spacing or self.aperture) ** 2) + 1

    def build(self) -> Mask:
        """Build the Poisson-disc mask.

        Raises
        ------
        InvalidInput
            When the spacing would give more than a million points.
        """
        from steradian.masks.poisson_disc import sample_poisson_disc

        if self.spacing is None:
            least = poisson_spacing(self.aperture, self.count or 1, self.seed)
            return self.replace(spacing=least, count=None).build()
        least = self.aperture * (0.7 / MAX_POINTS) ** 0.5
        if self.spacing < least:
            raise InvalidInput("spacing", self.spacing, f"at least {least:.3g} (m), a million points")
        positions = (sample_poisson_disc(self.spacing / self.aperture, self.seed) - 0.5) * self.aperture
        return Mask.create(
            aperture=self.aperture,
            positions=positions,
            weights=weights_for(self.weighting, positions, _square(self.aperture), np.ones(len(positions))),
            outline=_square(self.aperture),
            **self._fields_of_mask(),
        )


def _square(aperture: float) -> Outline:
    """Return the outline of the aperture, all of which is sensed."""
    return outlines.rectangle((-aperture / 2, -aperture / 2), (aperture / 2, aperture / 2))


def random_mask(
    aperture: float,
    count: int,
    *,
    depth: float | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
    weighting: Weighting = "voronoi",
) -> Mask:
    """Return a mask of ``count`` independent, uniformly distributed points; determined by the seed.

    The mask senses the whole aperture; each point stands for its Voronoi cell, or for X²/M if ``weighting`` is
    ``analytic`` or ``uniform``.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.
    """
    return Random.create(
        aperture=aperture, count=count, depth=depth, offset=offset, seed=seed, weighting=weighting
    ).build()


def poisson_disc_mask(
    aperture: float,
    spacing: float | None = None,
    *,
    count: int | None = None,
    depth: float | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
    weighting: Weighting = "voronoi",
) -> Mask:
    """Return a mask of Poisson-disc points, at least ``spacing`` metres apart, that leave no gap.

    With ``count`` instead of ``spacing`` the spacing is searched for that gives about so many. ``depth`` and
    ``offset`` in metres are those of the point of interest that the mask is judged for.

    The mask senses the whole aperture; each point stands for its Voronoi cell, or for X²/M if ``weighting`` is
    ``analytic`` or ``uniform``.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.
    """
    return PoissonDisc.create(
        aperture=aperture, spacing=spacing, count=count, depth=depth, offset=offset, seed=seed, weighting=weighting
    ).build()


def poisson_spacing(aperture: float, count: int, seed: int = 0) -> float:
    """Return the spacing in metres at which a seed's Poisson-disc points number about ``count``.

    Their number jumps by chance with the spacing; it is exact for most counts and off by a few at times.
    """
    low, high = 0.6, 1.1
    tried: dict[float, int] = {}

    def number(share: float) -> int:
        if share not in tried:
            spacing = aperture * share / sqrt(count)
            tried[share] = poisson_disc_mask(aperture, spacing, seed=seed, weighting="uniform").count
        return tried[share]

    for _ in range(8):
        middle = (low + high) / 2
        if number(middle) == count:
            break
        low, high = (middle, high) if number(middle) > count else (low, middle)
    centre = (low + high) / 2
    for step in range(TRIES):
        if count in tried.values():
            break
        number(centre * (1 + (-1) ** step * 0.0007 * (step // 2 + 1)))
    best = min(tried, key=lambda share: closeness_key(tried[share], count))
    return aperture * best / sqrt(count)
