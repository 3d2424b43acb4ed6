"""Metrics of one live-view revision."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from steradian.quality import correlation, tenenbaum


@dataclass
class Revision:
    """Metrics of one live-view revision, as written to ``revision.json``."""

    number: int
    points: int
    """A-lines the image is made of."""
    planned: int
    final: bool = False
    """The full reconstruction from the file, not a preview of it."""
    coverage: dict[str, float] = field(default_factory=dict)
    """``points`` and ``area``: share of the planned points and of the aperture they stand for; ``largest_gap_m``:
    distance to the nearest measured point at the place farthest from all."""
    quality: dict[str, float | None] = field(default_factory=dict)
    """Of the z-projection from the near field on (in 2-D of the image): ``correlation_with_previous`` revision, none
    for the first; ``sharpness``, the normalised Tenenbaum function of the image over its maximum; that ``maximum``."""
    image: dict[str, Any] = field(default_factory=dict)
    """``shape``, ``spacing_m`` and what made it coarser than the full image: ``modes`` and ``decimation`` in depth."""
    weights: str = ""
    seconds: dict[str, float] = field(default_factory=dict)
    """Wall time of each stage and ``total``."""


def quality_of(image: NDArray[Any], previous: NDArray[Any] | None) -> dict[str, float | None]:
    """Return quality metrics of a z-projection: sharpness, maximum, and correlation with the previous one."""
    peak = float(image.max())
    varies = peak > float(image.min())
    alike = None
    if varies and previous is not None and previous.max() > previous.min():
        alike = correlation(image, previous)
    return {
        "correlation_with_previous": alike,
        "sharpness": tenenbaum(image) / peak**2 if peak > 0 else None,
        "maximum": peak,
    }
