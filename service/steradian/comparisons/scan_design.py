"""Design of a scan from a number of laser pulses: points × averages, with the expected image of a vessel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, get_args

from steradian.comparisons.design_result import PulseSplit, ScanDesign
from steradian.comparisons.pulse_split import Budget, split_pulses
from steradian.comparisons.vessel_image import ImagingMethod, VesselImage
from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.masks import Counted
from steradian.quality.pulse_noise import PulseNoise

ARRANGEMENTS: Final[tuple[Counted, ...]] = ("equi-steradian", "grid", "hexagonal", "poisson-disc")
"""Arrangements that are tried by default: those of the mask comparison without random points."""
SPARSER: Final = 2
"""Of the iterative method, which takes far longer, every second split is simulated."""


def design_scan(
    *,
    depth: float,
    vessel: float,
    noise: PulseNoise | float,
    time: float | None = None,
    pulses: int | None = None,
    pulse_rate: float = 50.0,
    aperture: float = 13.56e-3,
    offset: tuple[float, float] = (0.0, 0.0),
    arrangements: Sequence[Counted] = ARRANGEMENTS,
    methods: Sequence[ImagingMethod] = get_args(ImagingMethod),
    averages: Sequence[int] | None = None,
    max_points: int = 20_000,
    modes: int | None = None,
    sampling_interval: float = 8e-9,
    sound_speed: float = 1500.0,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> ScanDesign:
    """Split a number of laser pulses between points and averages, and predict the image of a vessel for each split.

    The sensor is ideal and the vessel alone; more vessels have more side lobes. A direct image's noise depends on the
    number of pulses, hardly on their split; its side lobes fall with the number of points.

    Parameters
    ----------
    depth, vessel
        Distance from the film and diameter of a uniform vessel parallel to it, in metres.
    noise
        Peak of the strongest A-line over the noise's standard deviation, of one pulse, in dB; or as
        ``Scan.pulse_noise()`` measures it in a scan of a similar object.
    time, pulses
        Duration in seconds, or number of pulses: one of the two.
    pulse_rate
        Of the laser in Hz.
    aperture
        Side of the square aperture in metres.
    offset
        x and y of the vessel in metres.
    arrangements, methods
        To try.
    averages
        Pulses an A-line, to try; ``None``: about powers of two, of four for the iterative method.
    max_points
        Splits of more points are left out.
    modes
        Voxels on each lateral axis; ``None``: of 60 µm.
    sampling_interval, sound_speed
        Seconds and metres per second.
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Raises
    ------
    InvalidInput
        When a figure is out of range, or the pulses are too few for any split.
    Cancelled
        When ``cancelled`` said so.

    Examples
    --------
    >>> design = steradian.design_scan(depth=2.5e-3, vessel=150e-6, noise=10.0, time=900)  # doctest: +SKIP
    >>> design.chosen.points, design.chosen.averages  # doctest: +SKIP
    """
    budget = Budget.create(
        time=time,
        pulses=pulses,
        pulse_rate=pulse_rate,
        aperture=aperture,
        depth=depth,
        offset=offset,
        vessel=vessel,
        max_points=max_points,
        sampling_interval=sampling_interval,
        sound_speed=sound_speed,
    )
    measured = noise if isinstance(noise, PulseNoise) else PulseNoise(_checked_decibels(noise))
    for name, given, allowed in (
        ("arrangements", arrangements, get_args(Counted)),
        ("methods", methods, get_args(ImagingMethod)),
    ):
        wrong = [each for each in given if each not in allowed]
        if wrong or not given:
            raise InvalidInput(name, ", ".join(map(str, wrong)) or "none", "one or more of " + ", ".join(allowed))
    ladder = budget.ladder(averages)
    place = (*offset, depth)
    splits: list[PulseSplit] = []
    for arrangement in arrangements:
        plans = split_pulses(budget, arrangement, ladder, cancelled=cancelled)
        for method in (each for each in get_args(ImagingMethod) if each in methods):
            tried = plans if method == "direct" or averages is not None else plans[::-SPARSER][::-1]
            for done, (plan, seconds) in enumerate(tried):
                if cancelled and cancelled():
                    raise Cancelled("the design was stopped")
                if progress:
                    progress(f"{arrangement}: {method}", done, len(tried))
                image = VesselImage(
                    plan.mask, place, vessel, measured, plan.averages, sampling_interval, sound_speed, modes
                )
                expected = image.expect(method, cancelled=cancelled)
                splits.append(PulseSplit(arrangement, method, plan, seconds, expected))
            if progress:
                progress(f"{arrangement}: {method}", len(tried), len(tried))
    if not splits:
        raise InvalidInput("pulses", budget.pulses, "more, or fewer averages: no arrangement has so few points")
    return ScanDesign(tuple(splits), vessel, place, measured, budget.pulses)


def _checked_decibels(noise: float) -> float:
    if not -60 <= noise <= 120:
        raise InvalidInput("noise", noise, "-60 to 120 (dB)")
    return float(noise)
