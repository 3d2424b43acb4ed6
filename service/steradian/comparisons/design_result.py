"""Result of a scan design: splits of a number of pulses between points and averages, and the proposed ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from steradian.comparisons.vessel_image import MAX_CONTRAST_DB, ExpectedReading, ImagingMethod
from steradian.drawing import display_dispatch
from steradian.masks import Counted
from steradian.plans import ScanPlan
from steradian.quality.pulse_noise import PulseNoise

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WORTH_DB: Final = 1.0
"""A higher contrast by less than this is not worth more points."""
MAX_SCATTER: Final = 0.05
"""Largest relative standard deviation of the width where it counts as known: 19 of 20 readings are within a tenth."""
MAX_BIAS: Final = 0.1
"""Largest relative difference of a proposal's width from that with the most points."""


@dataclass(frozen=True)
class PulseSplit:
    """One way to split a number of pulses between points and averages, with the expected image of the vessel.

    Attributes
    ----------
    arrangement
        Of the points.
    method
        "direct" or "iterative".
    plan
        Scan plan with the mask.
    seconds
        Duration of the scan.
    expected
        Contrast, width and resolution.
    """

    arrangement: Counted
    method: ImagingMethod
    plan: ScanPlan = field(repr=False)
    seconds: float
    expected: ExpectedReading

    @property
    def points(self) -> int:
        """Number of points of the mask."""
        return self.plan.mask.count

    @property
    def averages(self) -> int:
        """Pulses averaged into an A-line."""
        return self.plan.averages

    @property
    def usable(self) -> bool:
        """Whether 19 of 20 scans are expected to show the width within a tenth: its scatter is at most 5 %."""
        return self.expected.width_scatter <= MAX_SCATTER and isfinite(self.expected.width)

    def as_json(self) -> dict[str, Any]:
        """Return all figures as JSON values; lengths in metres, null for unknown ones."""
        told: dict[str, Any] = {
            "arrangement": self.arrangement,
            "method": self.method,
            "points": self.points,
            "averages": self.averages,
            "seconds": self.seconds,
            "usable": self.usable,
        }
        found = self.expected
        figures = {
            "contrast_db": found.contrast_db,
            "side_lobes_db": found.side_lobes_db,
            "width_m": found.width,
            "width_scatter": found.width_scatter,
            "resolution_m": found.resolution,
        }
        return told | {name: value if isfinite(value) else None for name, value in figures.items()}


@dataclass(frozen=True)
class ScanDesign:
    """Splits of a number of pulses for each arrangement and method, and the proposed ones.

    Attributes
    ----------
    splits
        By arrangement, method and rising number of points.
    diameter, place
        Of the vessel in metres.
    noise
        Of one pulse.
    pulses
        That the laser fires.
    """

    splits: tuple[PulseSplit, ...]
    diameter: float
    place: tuple[float, float, float]
    noise: PulseNoise
    pulses: int

    @property
    def methods(self) -> tuple[ImagingMethod, ...]:
        """Methods that were tried."""
        return tuple(dict.fromkeys(split.method for split in self.splits))

    @property
    def arrangements(self) -> tuple[Counted, ...]:
        """Arrangements that were tried."""
        return tuple(dict.fromkeys(split.arrangement for split in self.splits))

    def of(self, arrangement: Counted, method: ImagingMethod) -> tuple[PulseSplit, ...]:
        """Return the splits of an arrangement and method by rising number of points."""
        return tuple(each for each in self.splits if (each.arrangement, each.method) == (arrangement, method))

    def proposal(self, arrangement: Counted, method: ImagingMethod) -> PulseSplit | None:
        """Return the proposed split (:func:`choose`)."""
        return choose(self.of(arrangement, method))

    def best(self, method: ImagingMethod) -> PulseSplit | None:
        """Return the usable proposal of the highest contrast; of equal ones the one nearest the vessel's width."""
        found = [self.proposal(each, method) for each in self.arrangements]
        proposed = [each for each in found if each is not None]
        if not proposed:
            return None
        return max(
            proposed,
            key=lambda each: (
                each.usable,
                round(each.expected.contrast_db, 1),
                -abs(each.expected.width - self.diameter),
            ),
        )

    @property
    def chosen(self) -> PulseSplit | None:
        """Best split of the direct method if it was tried, whose image is there during the scan; else of the other."""
        return self.best(self.methods[0])

    def as_json(self) -> dict[str, Any]:
        """Return all splits and the proposals as JSON values."""
        return {
            "pulses": self.pulses,
            "vessel_m": self.diameter,
            "place_m": list(self.place),
            "noise_db": self.noise.decibels,
            "max_contrast_db": MAX_CONTRAST_DB,
            "splits": [
                split.as_json() | {"proposed": split is self.proposal(split.arrangement, split.method)}
                for split in self.splits
            ],
            "chosen": None if self.chosen is None else self.chosen.as_json(),
        }

    def plot(self, axes: Axes | None = None) -> Axes:
        """Plot the expected contrast over the number of points; proposals are ringed."""
        return display_dispatch.plot(self, axes)

    def save(self, path: str | Path) -> None:
        """Draw contrast and width over the number of points into a picture file, such as ``design.png``."""
        display_dispatch.save(self, Path(path))


def choose(splits: Sequence[PulseSplit]) -> PulseSplit | None:
    """Return the fewest points whose contrast is within 1 dB of the highest; ``None``: the vessel shows in no split.

    Splits count that are usable, all where none is, and whose width is within a tenth of that with the most points.
    """
    seen = sorted((each for each in splits if isfinite(each.expected.width)), key=lambda each: each.points)
    if not seen:
        return None
    known = [each for each in seen if each.usable] or seen
    dense = known[-1].expected.width
    alike = [each for each in known if abs(each.expected.width / dense - 1) <= MAX_BIAS]
    highest = max(each.expected.contrast_db for each in alike)
    return next(each for each in alike if each.expected.contrast_db >= highest - WORTH_DB)
