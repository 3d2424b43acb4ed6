"""Splits of a number of laser pulses: for each number of averages the mask of most points that fits into the time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor
from typing import Final

from steradian.comparisons.vessel_image import LEAST_UNIT, needed_samples
from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.core.progress import CancelCheck
from steradian.masks import Counted, Mask, mask_by_count
from steradian.masks.arrangement_base import MAX_POINTS
from steradian.plans import ScanPlan, preview

MIN_POINTS: Final = 64
MOST_AVERAGES: Final = 65_535
MAX_VALUES: Final = 2**26
"""Samples of all A-lines of a split that is simulated: 256 MiB in single precision."""
_TRIES: Final = 8


@dataclass(frozen=True)
class Budget:
    """Time and pulses of a scan, and the vessel that it is for.

    Attributes
    ----------
    seconds, pulse_rate
        Duration of the scan in seconds, and pulses per second.
    aperture, depth, offset, vessel
        In metres.
    max_points
        Of a split.
    sampling_interval, sound_speed
        Seconds and metres per second.
    """

    seconds: float
    pulse_rate: float
    aperture: float
    depth: float
    offset: tuple[float, float]
    vessel: float
    max_points: int
    sampling_interval: float
    sound_speed: float

    @classmethod
    def create(
        cls,
        *,
        time: float | None,
        pulses: int | None,
        pulse_rate: float,
        aperture: float,
        depth: float,
        offset: tuple[float, float],
        vessel: float,
        max_points: int,
        sampling_interval: float,
        sound_speed: float,
    ) -> Budget:
        """Return a checked budget; raises :class:`InvalidInput` naming a field that is out of range."""
        for name, value, low, high, unit in (
            ("pulse_rate", pulse_rate, 0.1, 10_000.0, "Hz"),
            ("aperture", aperture, 1e-4, 0.2, "m"),
            ("depth", depth, 5e-5, 0.1, "m"),
            ("vessel", vessel, 1e-5, 5e-3, "m"),
            ("max_points", max_points, MIN_POINTS, MAX_POINTS, "points"),
        ):
            if not low <= value <= high:
                raise InvalidInput(name, value, f"{low:g} to {high:g} ({unit})")
        if vessel / 2 >= depth:
            raise InvalidInput("vessel", vessel, f"below twice the depth, {2 * depth:g} m, else it reaches the film")
        if (time is None) == (pulses is None):
            raise InvalidInput("pulses", "both or neither of time and pulses", "one of the two")
        if time is None:
            assert pulses is not None  # noqa: S101 - one of the two
            time = pulses / pulse_rate
        if not MIN_POINTS <= time * pulse_rate <= 1e9:
            name, value = ("time", time) if pulses is None else ("pulses", pulses)
            raise InvalidInput(name, value, f"{MIN_POINTS} to 1e9 pulses")
        return cls(time, pulse_rate, aperture, depth, offset, vessel, int(max_points), sampling_interval, sound_speed)

    @property
    def pulses(self) -> int:
        """Number of pulses that the laser fires in the time."""
        return floor(self.seconds * self.pulse_rate * (1 + 1e-12))

    @property
    def place(self) -> tuple[float, float, float]:
        """Place of the vessel, x, y, z in metres."""
        return (*self.offset, self.depth)

    def ladder(self, averages: Sequence[int] | None = None) -> tuple[int, ...]:
        """Return the numbers of averages to try, falling: powers of two that leave a possible number of points.

        Raises
        ------
        InvalidInput
            When one of ``averages`` is out of range or leaves too few or too many points.
        """
        if averages is None:
            powers = [2**power for power in range(17) if 2**power <= MOST_AVERAGES]
            fitting = [each for each in powers if MIN_POINTS <= self.pulses / each <= self.max_points]
            fewest = min(MOST_AVERAGES, max(1, round(self.pulses / self.max_points)))
            return tuple(sorted(fitting or [fewest], reverse=True))
        # masks of half the points are proposed where an arrangement has no larger one
        least, most = max(1, -(-self.pulses // self.max_points)), min(MOST_AVERAGES, self.pulses // (MIN_POINTS // 2))
        for each in averages:
            if each != int(each) or not least <= each <= most:
                raise InvalidInput("averages", each, f"whole numbers from {least} to {most}")
        return tuple(sorted({int(each) for each in averages}, reverse=True))


def split_pulses(
    budget: Budget, arrangement: Counted, ladder: Sequence[int], *, cancelled: CancelCheck | None = None
) -> list[tuple[ScanPlan, float]]:
    """Return the plan of most points that fits into the time, and its seconds, for each number of averages.

    Numbers of averages for which the arrangement has no such mask are left out. Where its next smaller mask leaves
    pulses over, more of them are averaged.
    """
    found: list[tuple[ScanPlan, float]] = []
    for averages in ladder:
        if cancelled and cancelled():
            raise Cancelled("the design was stopped")
        fitting = _largest_fitting(budget, arrangement, averages)
        if fitting is not None and (not found or fitting[0].mask.count > found[-1][0].mask.count):
            found.append(fitting)
    return found


def _largest_fitting(budget: Budget, arrangement: Counted, averages: int) -> tuple[ScanPlan, float] | None:
    """Return the plan of about the most points that fits; arrangements do not have every number of points."""
    wanted, lowered = min(budget.max_points, budget.pulses // averages), 1
    for _ in range(_TRIES):
        if wanted < MIN_POINTS // 2:
            break
        mask = mask_by_count(arrangement, budget.aperture, wanted, depth=budget.depth, offset=budget.offset)
        plan = _plan(budget, mask, averages)
        seconds = preview(plan).total_seconds
        if seconds <= budget.seconds * (1 + 1e-9):
            spare = floor((budget.seconds - seconds) * budget.pulse_rate / mask.count + 1e-9)
            if not spare:
                return plan, seconds
            fuller = _plan(budget, mask, min(averages + spare, MOST_AVERAGES))
            return fuller, preview(fuller).total_seconds
        excess = mask.count - floor(mask.count * budget.seconds / seconds)
        wanted -= max(excess, lowered)
        lowered = max(2 * lowered, round(0.01 * wanted))
    return None


def _plan(budget: Budget, mask: Mask, averages: int) -> ScanPlan:
    step = budget.sampling_interval * budget.sound_speed
    samples = needed_samples(mask, budget.place, max(budget.vessel, LEAST_UNIT), step)
    if mask.count * samples > MAX_VALUES:
        least = budget.sampling_interval * mask.count * samples / MAX_VALUES
        allowed = f"at least {least:.2g} s for {mask.count} points, or a lower max_points"
        raise InvalidInput("sampling_interval", budget.sampling_interval, allowed)
    return ScanPlan.create(
        mask=mask,
        pulse_rate=budget.pulse_rate,
        averages=averages,
        samples=samples,
        sampling_interval=budget.sampling_interval,
        sound_speed=budget.sound_speed,
    )
