"""Equi-steradian masks: each point covers the same solid angle seen from the point of interest (paper, appendix A)."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, ceil, tan
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from steradian.core.choices import Weighting
from steradian.core.quantity_ranges import LENGTH
from steradian.core.validation import Value, quantity_field
from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.polygons import Outline
from steradian.masks.arrangement_base import check_offset
from steradian.masks.cap_slices import Slices, convenient_below, convenient_slices
from steradian.masks.mask import Mask
from steradian.masks.scanner_grid import ScannerGrid
from steradian.masks.solid_angle_solver import equalise_solid_angles, unit_angle
from steradian.masks.weights import expand_outline, weights_for


class EquiSteradian(Value):
    """Parameters of an equi-steradian mask around a point of interest anywhere over the aperture."""

    arrangement: Literal["equi-steradian"] = "equi-steradian"
    aperture: float = quantity_field("m", "Side X of the square aperture", **LENGTH.limits)
    depth: float = quantity_field("m", "Distance r0 of the point of interest from the sensor plane", **LENGTH.limits)
    count: int = quantity_field(
        "points", "Number of points; the nearest number whose last slice ends on the rim is used", ge=5, le=1_000_000
    )
    offset: tuple[float, float] = Field(
        default=(0.0, 0.0), description="x and y of the point of interest, centred on the aperture (m)"
    )
    grid: ScannerGrid | None = Field(default=None, description="Places where the scanner can stop, if not anywhere")
    weighting: Weighting = "voronoi"

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_offset(self.offset, self.aperture)
        return self

    @property
    def expected_count(self) -> int:
        """Approximate number of points of the mask."""
        return self.count

    def build(self) -> Mask:
        """Build the equi-steradian mask.

        Raises
        ------
        InvalidInput
            When the grid to snap to is wider than the aperture.
        """
        pattern = self.pattern()
        positions, weights = pattern.positions, pattern.distances**3  # paper, section 4.2: h ∝ r³
        if self.grid is not None:
            positions, weights = self.grid.snap(positions, weights)
        outline = expand_outline(self.outline(), positions)
        return Mask.create(
            aperture=self.aperture,
            depth=self.depth,
            offset=self.offset,
            positions=positions,
            weights=weights_for(self.weighting, positions, outline, weights),
            outline=outline,
            arrangement=self.model_dump(mode="json") | {"slices": list(pattern.slices.counts)},
        )

    def pattern(self) -> EquiSteradianPattern:
        """Return the pattern of points before snapping: the convenient count nearest to ``count``."""
        above, below = self._at_least(), self._below()
        if below is not None and self.count - self._kept(below) < self._kept(above) - self.count:
            return self._pattern(below)
        return self._pattern(above)

    def _at_least(self) -> Slices:
        """Return the smallest convenient pattern of at least ``count`` points."""
        slices = convenient_slices(self._rim, self.count)
        while (kept := self._kept(slices)) < self.count:  # part of the cap lies beyond the aperture
            lacking = (self.count - kept) * slices.total / max(kept, 1)
            slices = convenient_slices(self._rim, slices.total + max(1, ceil(0.9 * lacking)))
        while self._is_offset:
            smaller = convenient_below(self._rim, slices.total)
            if smaller is None or self._kept(smaller) < self.count:
                break
            slices = smaller
        return slices

    def outline(self) -> Outline:
        """Return the outline of the sensed area: a disc below the point of interest, clipped to the aperture."""
        half = np.full(2, self.aperture / 2)
        disc = outlines.disc(self.offset, self.depth * tan(self._rim))
        return outlines.intersection(disc, outlines.rectangle(-half, half))

    def neighbouring_counts(self) -> tuple[int | None, int]:
        """Return the convenient counts below (None if there is none) and above ``count``."""
        below = self._below()
        return None if below is None else self._kept(below), self._kept(self._at_least())

    def _below(self) -> Slices | None:
        """Return the largest convenient pattern of fewer than ``count`` points."""
        slices = self._at_least()
        while (smaller := convenient_below(self._rim, slices.total)) is not None:
            if self._kept(smaller) < self.count:
                return smaller
            slices = smaller
        return None

    @property
    def _is_offset(self) -> bool:
        return self.offset != (0.0, 0.0)

    @property
    def _rim(self) -> float:
        """Polar angle of the pattern's rim, from the foot's distance to the aperture's farthest edge."""
        return atan((self.aperture / 2 + max(abs(self.offset[0]), abs(self.offset[1]))) / self.depth)

    def _kept(self, slices: Slices) -> int:
        return self._pattern(slices).count if self._is_offset else slices.total

    def _pattern(self, slices: Slices) -> EquiSteradianPattern:
        positions = equalise_solid_angles(slices, self._rim).project(self.depth)
        unit = unit_angle(slices.counts, self._rim)
        if self._is_offset:
            positions = positions + np.asarray(self.offset)
            positions = positions[np.abs(positions).max(axis=1) <= self.aperture / 2]
        return EquiSteradianPattern(positions, np.array([*self.offset, self.depth]), unit, slices)


@dataclass(frozen=True)
class EquiSteradianPattern:
    """Pattern of points of equal solid angle.

    Attributes
    ----------
    positions
        (M, 2) metres.
    point_of_interest
        x, y, z in metres.
    unit
        Solid angle of each point in steradians.
    slices
        How the whole cap is sliced, before what lies beyond the aperture was dropped.
    """

    positions: NDArray[np.float64]
    point_of_interest: NDArray[np.float64]
    unit: float
    slices: Slices

    @property
    def count(self) -> int:
        """Number of points within the aperture."""
        return len(self.positions)

    @property
    def distances(self) -> NDArray[np.float64]:
        """Distances r (M,) from the point of interest in metres."""
        return self.distances_of(self.positions)

    def distances_of(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distances r of positions (M, 2) from the point of interest in metres."""
        across = ((positions - self.point_of_interest[:2]) ** 2).sum(axis=1)
        found: NDArray[np.float64] = np.sqrt(across + self.point_of_interest[2] ** 2)
        return found

    def spacing(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the expected distance in metres between neighbours: the square root of a point's area."""
        share = self.unit * self.distances_of(positions) ** 3 / self.point_of_interest[2]
        found: NDArray[np.float64] = np.sqrt(share)
        return found


def equi_steradian_mask(
    aperture: float,
    depth: float,
    count: int,
    *,
    offset: tuple[float, float] = (0.0, 0.0),
    grid: ScannerGrid | None = None,
    weighting: Weighting = "voronoi",
) -> Mask:
    """Return a mask whose points each cover the same solid angle seen from the point of interest.

    Parameters
    ----------
    aperture
        Side X of the square aperture in metres.
    depth
        Distance r0 of the point of interest from the sensor plane in metres.
    count
        Wanted number of points. Slices hold powers of two and the last one ends on the rim, so the nearest
        convenient number is taken (1,600 becomes 1,605; see :func:`convenient_counts`).
    offset
        x and y of the point of interest in metres. Away from the centre the slices go on to the farthest edge of the
        aperture, and points beyond another edge are left out.
    grid
        Places where the scanner can stop; points that meet on one are merged.
    weighting
        ``voronoi``: each point's own cell, at the rim as far as the disc; ``analytic``: the paper's h ∝ r³, which gives
        the last slice what lies beyond the rim and takes it from all (2 to 4 % of 1,600 points' amplitude, up to 10 %
        of 300 points'); ``uniform``.

    Returns
    -------
    Mask
        Innermost points first, the last slice at the rim; weights sum to the sensed area: the disc inscribed in the
        aperture, or, away from the centre, what the disc to the farthest edge has in common with the aperture.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.

    Notes
    -----
    Paper, appendix A and section 4.2, with one change: the slices are moved a little so that their Voronoi cells, and
    not only the units, are equal (:mod:`steradian.masks.solid_angle_solver`).

    Examples
    --------
    >>> equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=1600).count
    1605
    """
    return EquiSteradian.create(
        aperture=aperture, depth=depth, count=count, offset=offset, grid=grid, weighting=weighting
    ).build()


def convenient_counts(
    aperture: float, depth: float, count: int, offset: tuple[float, float] = (0.0, 0.0)
) -> tuple[int | None, int]:
    """Return the convenient counts around ``count``: the largest below (``None`` if there is none) and the next.

    The second is ``count`` itself where that is convenient.
    """
    wanted = EquiSteradian.create(aperture=aperture, depth=depth, count=count, offset=offset)
    return wanted.neighbouring_counts()
