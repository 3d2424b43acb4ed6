"""Adaptive acquisition in stages: rules for stages of a scan whose points follow from the image of the earlier ones.

The first stage of such a scan is the plan's mask, a survey. Each further stage is a :class:`FocusStage`; a
:class:`StoppingRule` may end the scan early.
"""

from __future__ import annotations

from math import ceil
from typing import Literal, Self, TypeAlias

from pydantic import Field, model_validator

from steradian.core.choices import VisitOrder
from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH
from steradian.core.validation import Value

Points: TypeAlias = tuple[tuple[float, float, float], ...]
"""Points of interest: x, y and depth of each in m."""
Choice = Literal["brightest", "nearest", "several"]
MOST_STAGES = 4
MOST_POINTS_OF_INTEREST = 8
FEWEST_POINTS = 5
"""Points of an equi-steradian mask, at least."""


class FocusRule(Value):
    """Rule for the points of interest of a stage, which are found in the image of the earlier stages."""

    choice: Choice = Field(
        default="brightest",
        description="Points of interest: the brightest place, the nearest to the film, or several, by brightness",
    )
    count: int = Field(
        default=1, ge=1, le=MOST_POINTS_OF_INTEREST, description="Points of interest, at most; above 1 with several"
    )
    decision: Literal["auto", "ask"] = Field(
        default="auto", description="auto: the proposal is taken; ask: the laser rests until a person chooses"
    )
    points_of_interest: tuple[tuple[float, float, float], ...] = Field(
        default=(),
        max_length=MOST_POINTS_OF_INTEREST,
        description="x, y and depth (m) of points of interest that are known already; none: they are searched",
    )
    least_signal_to_noise: float = Field(
        default=18.0, ge=1, le=1000, description="Least peak of a place over the noise of the survey's image"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.count > 1 and self.choice != "several":
            raise InvalidInput(
                "count", self.count, f"1 with {self.choice}; up to {MOST_POINTS_OF_INTEREST} with several"
            )
        for number, (_, _, depth) in enumerate(self.points_of_interest):
            if not 0 < depth <= LENGTH.limits["le"]:
                raise InvalidInput(
                    f"points_of_interest[{number}]",
                    f"a depth of {depth:g}",
                    f"> 0, at most {LENGTH.limits['le']:g} (m)",
                )
        return self


class FocusStage(FocusRule):
    """Stage of a scan that is equi-steradian around points of interest found in the image of the earlier stages."""

    points: int = Field(ge=FEWEST_POINTS, le=1_000_000, description="Points of the stage, at most")


class StoppingRule(Value):
    """Stopping rule of a scan: limits of which each ends it before all points are measured.

    :mod:`steradian.quality.stopping_rule` has the figures that are compared with them.
    """

    max_gain: float | None = Field(
        default=0.004, gt=0, lt=1, description="Greatest expected rise of the correlation with the object by the rest"
    )
    max_change: float | None = Field(
        default=None, gt=0, lt=1, description="Greatest expected 1 − correlation with the image of all points"
    )
    max_noise_db: float | None = Field(
        default=None, ge=-200, lt=0, description="Level of the image's error over its maximum (dB)"
    )
    min_points: int | None = Field(
        default=None, ge=16, le=1_000_000, description="Points measured in any case; null: half of all"
    )
    max_points: int | None = Field(default=None, ge=16, le=1_000_000, description="Points at most; null: all")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.min_points is not None and self.max_points is not None and self.min_points > self.max_points:
            raise InvalidInput("min_points", self.min_points, f"at most max_points, {self.max_points}")
        return self

    def bounds(self, most: int) -> tuple[int, int]:
        """Return the least and the greatest number of points of a scan of at most ``most`` points."""
        greatest = most if self.max_points is None else min(self.max_points, most)
        return min(ceil(most / 2) if self.min_points is None else self.min_points, greatest), greatest


def check_stopping(rule: StoppingRule | None, order: VisitOrder, frames: int, surveyed: int) -> None:
    """Raise ``InvalidInput`` for a plan whose parts cannot be compared with all of it.

    ``surveyed`` is the number of points that are measured before the last stage.
    """
    if rule is None:
        return
    if rule.max_points is not None and rule.max_points <= surveyed:
        raise InvalidInput("max_points", rule.max_points, f"more than {surveyed}, the points of the survey")
    if order is not VisitOrder.PROGRESSIVE:
        raise InvalidInput("order", str(order), "progressive with a stopping rule: each part is then an even mask")
    if frames > 1:
        raise InvalidInput("frames", frames, "1 with a stopping rule")


def check_stages(stages: tuple[FocusStage, ...], *, is_line: bool, beams: int) -> None:
    """Raise ``InvalidInput`` for a plan that cannot be measured in stages."""
    if stages and is_line:
        raise InvalidInput("stages", f"{len(stages)} of a line of sensors", "none; stages are of a plane")
    if stages and beams > 1:
        raise InvalidInput("stages", f"{len(stages)} with {beams} beams", "none with several beams")


class Proposal(Value):
    """Point of interest found in the image of a survey, with the promise of a mask focused there."""

    position: tuple[float, float, float] = Field(description="x, y and depth (m)")
    signal_to_noise: float = Field(description="Peak of the smoothed image over its noise at that depth")
    promise: dict[str, float] = Field(
        default_factory=dict, description="Figures of the focused mask at this place: resolutions (m), solid angle (sr)"
    )


class StageRecord(Value):
    """Record of a stage in a scan file: its points, and the decision that made it."""

    number: int = Field(ge=1, description="1: the survey")
    points: int = Field(ge=1, description="Points of this stage")
    plan_id: str = Field(description="Plan whose mask ends with this stage")
    points_of_interest: tuple[tuple[float, float, float], ...] = Field(default=(), description="x, y and depth (m)")
    proposals: tuple[Proposal, ...] = Field(default=(), description="What the image before this stage showed")
    decided_by: str = Field(default="", description="auto (its rule), plan, caller (an option), or a person's name")
    made: str = Field(default="", description="When, ISO 8601")
