"""Stopping rule of a scan: expected change of the image by the points that are still to come.

Images of parts of a scan are compared. The error of an image of n points in progressive order has about the variance
of a mean of n independent terms, so two images of n < m points differ by 1 − correlation ≈ a·(1/n − 1/m). The factor a
is the greatest of those that the latest image shows beside three earlier ones; the law then gives the difference from
the image of all points. The error e = a/n of a projection of maxima hides beneath the object until the two are
comparable: its correlation with the object falls by about e²/2, which was found by experiment (docs/stages.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, log10, sqrt
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.quality.pearson import correlation
from steradian.quality.regions import same_shape

Reason = Literal["gain", "change", "noise", "points"]
BASELINES = (0.85, 0.7, 0.55)
"""An image is compared with the latest ones of at most these parts of its points."""
MAX_EXPECTED_GAIN = 0.004
"""Five yarns through 1,605 points stop within 0.005 of the full scan's correlation with it."""
MIN_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class RevisionImage:
    """Image of the points measured so far.

    Attributes
    ----------
    points
        Number of points.
    image
        Any number of axes; of a running scan the z-projection beyond the near field.
    """

    points: int
    image: NDArray[Any]


@dataclass(frozen=True)
class StoppingRule:
    """Limits of which each ends a scan early; ``None``: not this one.

    Attributes
    ----------
    max_gain
        Greatest expected rise of the correlation with the object by the rest of the points.
    max_change
        Greatest expected 1 − correlation between the image and that of all points.
    max_noise_db
        Level of the image's error over its maximum, 20·log₁₀, such as −40.
    min_points
        Points before which none of these ends the scan; ``None``: half of those planned.
    max_points
        Points that end the scan in any case; ``None``: all planned.
    """

    max_gain: float | None = MAX_EXPECTED_GAIN
    max_change: float | None = None
    max_noise_db: float | None = None
    min_points: int | None = None
    max_points: int | None = None

    def __post_init__(self) -> None:
        for name in ("max_gain", "max_change"):
            value = getattr(self, name)
            if value is not None and not 0 < value < 1:
                raise InvalidInput(name, value, "above 0, below 1")
        if self.max_noise_db is not None and not self.max_noise_db < 0:
            raise InvalidInput("max_noise_db", self.max_noise_db, "< 0 (dB)")
        least = self.min_points or 1
        if least < 1:
            raise InvalidInput("min_points", least, "1 or more (points)")
        if self.max_points is not None and self.max_points < least:
            raise InvalidInput("max_points", self.max_points, f"{least} or more (points)")


@dataclass(frozen=True)
class StopDecision:
    """Decision whether a scan has enough points.

    Attributes
    ----------
    stop
        Whether the scan may end.
    reason
        Limit that was reached: ``gain``, ``change``, ``noise`` or ``points``; ``None`` if none was.
    gain, change, noise_db
        Expected figures (:class:`StoppingRule`); ``None`` while there are too few images to compare.
    earliest, latest
        Range of the number of points at which the scan is expected to end.
    """

    stop: bool
    reason: Reason | None
    gain: float | None
    change: float | None
    noise_db: float | None
    earliest: int
    latest: int


def decide(rule: StoppingRule, revisions: Sequence[RevisionImage], planned: int) -> StopDecision:
    """Decide whether a scan has enough points.

    Parameters
    ----------
    rule
        The limits.
    revisions
        Images so far with rising numbers of points; earlier ones than half of the latest's points are of no use.
    planned
        Number of points of the whole scan.

    Raises
    ------
    InvalidInput
        When the numbers of points do not rise or exceed ``planned``, or the images differ in shape.
    """
    _check(revisions, planned)
    least = planned * MIN_SHARE if rule.min_points is None else rule.min_points
    most = planned if rule.max_points is None else min(rule.max_points, planned)
    if not revisions:
        return StopDecision(False, None, None, None, None, min(round(least), most), most)
    now = revisions[-1].points
    rates, noise = _rates(revisions), expected_noise_db(revisions)
    gain = change = None
    if rates:
        change = max(rates) * (1 / now - 1 / planned)
        gain = _gain(max(rates), now, planned)
    reason: Reason | None = None
    if now >= most:
        reason = "points"
    elif now >= least:
        reason = _reached(rule, gain, change, noise)
    ends = [_end(rule, rate, noise, now, planned) for rate in ([min(rates), max(rates)] if rates else [])]
    earliest, latest = (min(ends), max(ends)) if ends else (0.0, inf)
    if reason:
        earliest = latest = now
    low = int(min(max(earliest, least, now), most))
    return StopDecision(reason is not None, reason, gain, change, noise, low, int(max(low, min(latest, most))))


def expected_change(revisions: Sequence[RevisionImage], planned: int) -> float | None:
    """Return the expected 1 − correlation between the latest image and that of all planned points.

    ``None`` while there is no image of at most 85 % of the latest one's points.
    """
    _check(revisions, planned)
    rates = _rates(revisions)
    return max(rates) * (1 / revisions[-1].points - 1 / planned) if rates else None


def expected_gain(revisions: Sequence[RevisionImage], planned: int) -> float | None:
    """Return the expected rise of a projection's correlation with the object by the rest of the planned points."""
    _check(revisions, planned)
    rates = _rates(revisions)
    return _gain(max(rates), revisions[-1].points, planned) if rates else None


def expected_noise_db(revisions: Sequence[RevisionImage]) -> float | None:
    """Return the level of the latest image's error over its maximum, 20·log₁₀.

    The mean square difference of two images of n < m points is σ²·(1/n − 1/m), the mean square error σ²/m.
    """
    earlier = _earlier(revisions)
    if not earlier:
        return None
    last = revisions[-1]
    peak = float(np.abs(last.image).max())
    powers = [
        float(np.mean(np.square(last.image - before.image, dtype=np.float64))) / (1 / before.points - 1 / last.points)
        for before in earlier
    ]
    level = sqrt(max(powers) / last.points)
    return 20 * log10(level / peak) if level > 0 and peak > 0 else None


def _check(revisions: Sequence[RevisionImage], planned: int) -> None:
    counts = [revision.points for revision in revisions]
    if any(after <= before for before, after in zip([0, *counts], counts, strict=False)):
        raise InvalidInput("revisions", f"{counts} points", "numbers of points that rise from 1")
    if counts and counts[-1] > planned:
        raise InvalidInput("planned", planned, f"{counts[-1]} or more (points)")
    for number, revision in enumerate(revisions):
        same_shape(f"revisions[{number}]", revision.image, revisions[-1].image.shape, "the latest")


def _earlier(revisions: Sequence[RevisionImage]) -> list[RevisionImage]:
    """Return the earlier images with which the latest is compared."""
    found: list[RevisionImage] = []
    for share in BASELINES:
        before = [each for each in revisions[:-1] if each.points <= share * revisions[-1].points]
        if before and before[-1] not in found:
            found.append(before[-1])
    return found


def _rates(revisions: Sequence[RevisionImage]) -> list[float]:
    """Return the factor a of the law by comparison of the latest image with each earlier one."""
    rates = []
    for before in _earlier(revisions):
        last = revisions[-1]
        if not (np.ptp(before.image) > 0 and np.ptp(last.image) > 0):
            continue
        change = 1 - correlation(before.image, last.image)
        rates.append(change / (1 / before.points - 1 / last.points))
    return rates


def _gain(rate: float, points: int, planned: int) -> float:
    return rate**2 / 2 * (1 / points**2 - 1 / planned**2)


def _reached(rule: StoppingRule, gain: float | None, change: float | None, noise: float | None) -> Reason | None:
    if rule.max_gain is not None and gain is not None and gain <= rule.max_gain:
        return "gain"
    if rule.max_change is not None and change is not None and change <= rule.max_change:
        return "change"
    if rule.max_noise_db is not None and noise is not None and noise <= rule.max_noise_db:
        return "noise"
    return None


def _end(rule: StoppingRule, rate: float, noise: float | None, now: int, planned: int) -> float:
    """Return the number of points at which the first limit is expected to be reached."""
    ends: list[float] = []
    if rule.max_gain is not None:
        ends.append(1 / sqrt(2 * rule.max_gain / max(rate, 1e-100) ** 2 + 1 / planned**2))
    if rule.max_change is not None:
        ends.append(1 / (rule.max_change / max(rate, 1e-100) + 1 / planned))
    if rule.max_noise_db is not None and noise is not None:
        ends.append(now * 10 ** ((noise - rule.max_noise_db) / 10))
    return min(ends, default=inf)
