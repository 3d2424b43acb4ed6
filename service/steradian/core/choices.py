"""Named choices of masks and plans, which command help lists without an import of numpy."""

from __future__ import annotations

from enum import StrEnum
from typing import Literal, TypeAlias

Weighting: TypeAlias = Literal["analytic", "voronoi", "uniform"]
"""``voronoi``: the area of each point's own cell within the sensed outline; ``analytic``: one over the density the
arrangement was made with; ``uniform``: equal shares. All sum to the sensed area."""


class VisitOrder(StrEnum):
    """Names of the visit orders of a mask's points."""

    GIVEN = "given"
    """As the mask lists them."""
    SNAKE = "snake"
    """In strips, up one and down the next."""
    HILBERT = "hilbert"
    """Along a Hilbert curve: neighbours in time are neighbours in space."""
    SHORTEST = "shortest"
    """Nearest neighbour, then improved by 2-opt and Or-opt moves."""
    WAVELENGTH = "wavelength"
    """By bias wavelength, so that the interrogation laser is seldom retuned; a short way within each wavelength."""
    BANDS = "bands"
    """In bands of bias wavelength where that is quicker, within a plan's loss of sensitivity; least time in all."""
    PROGRESSIVE = "progressive"
    """In passes that double in size, each prefix a sparser mask of the same kind; a short way within each pass."""
