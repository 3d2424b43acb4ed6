"""Points by chance: independent ones, and ones that keep their distance."""

from __future__ import annotations

from typing import Literal

import numpy as np

from steradian.errors import InvalidInput
from steradian.imaging import outlines
from steradian.imaging.outlines import Outline
from steradian.masks.mask import Mask
from steradian.masks.weights import Weighting, weights_for
from steradian.ranges import LENGTH
from steradian.validation import Value, quantity

MOST_POINTS = 1_000_000


class Random(Value):
    """Parameters of independent, uniformly distributed points."""

    arrangement: Literal["random"] = "random"
    aperture: float = quantity("m", "Side X of the square aperture", **LENGTH.limits)
    count: int = quantity("points", "Number of points", ge=1, le=MOST_POINTS)
    seed: int = quantity("any", "The same seed gives the same points", ge=0, lt=2**63, default=0)
    weighting: Weighting = "voronoi"

    @property
    def expected_count(self) -> int:
        """How many points the mask will have."""
        return self.count

    def build(self) -> Mask:
        """Place the points."""
        positions = (np.random.default_rng(self.seed).random((self.count, 2)) - 0.5) * self.aperture
        return Mask.create(
            aperture=self.aperture,
            positions=positions,
            weights=weights_for(self.weighting, positions, _square(self.aperture), np.ones(self.count)),
            outline=_square(self.aperture),
            arrangement=self.model_dump(mode="json"),
        )


class PoissonDisc(Value):
    """Parameters of points by chance of which no two are closer than ``spacing`` and no gap takes another."""

    arrangement: Literal["poisson-disc"] = "poisson-disc"
    aperture: float = quantity("m", "Side X of the square aperture", **LENGTH.limits)
    spacing: float = quantity("m", "Least distance between two points", **LENGTH.limits)
    seed: int = quantity("any", "The same seed gives the same points", ge=0, lt=2**63, default=0)
    weighting: Weighting = "voronoi"

    @property
    def expected_count(self) -> int:
        """About how many points the mask will have: discs of the spacing's diameter cover 55 % of the plane."""
        return round(0.7 * (self.aperture / self.spacing) ** 2) + 1

    def build(self) -> Mask:
        """Place the points.

        Raises
        ------
        InvalidInput
            When the spacing would give more than a million points.
        """
        from steradian.masks.dart import throw_darts

        least = self.aperture * (0.7 / MOST_POINTS) ** 0.5
        if self.spacing < least:
            raise InvalidInput("spacing", self.spacing, f"at least {least:.3g} (m), a million points")
        positions = (throw_darts(self.spacing / self.aperture, self.seed) - 0.5) * self.aperture
        return Mask.create(
            aperture=self.aperture,
            positions=positions,
            weights=weights_for(self.weighting, positions, _square(self.aperture), np.ones(len(positions))),
            outline=_square(self.aperture),
            arrangement=self.model_dump(mode="json"),
        )


def _square(aperture: float) -> Outline:
    """Outline of the aperture, all of which is sensed."""
    return outlines.rectangle((-aperture / 2, -aperture / 2), (aperture / 2, aperture / 2))


def random_mask(aperture: float, count: int, *, seed: int = 0, weighting: Weighting = "voronoi") -> Mask:
    """Scatter ``count`` points over the aperture independently; the same seed gives the same points.

    The mask senses the whole aperture; each point stands for its Voronoi cell, or for X²/M if ``weighting`` is
    ``analytic`` or ``uniform``.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.
    """
    return Random.create(aperture=aperture, count=count, seed=seed, weighting=weighting).build()


def poisson_disc_mask(aperture: float, spacing: float, *, seed: int = 0, weighting: Weighting = "voronoi") -> Mask:
    """Scatter points over the aperture, none closer than ``spacing`` metres to another, until no more fit.

    The mask senses the whole aperture; each point stands for its Voronoi cell, or for X²/M if ``weighting`` is
    ``analytic`` or ``uniform``.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.
    """
    return PoissonDisc.create(aperture=aperture, spacing=spacing, seed=seed, weighting=weighting).build()
