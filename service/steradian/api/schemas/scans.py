"""Request schema of scans."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

from steradian.core.exceptions import InvalidInput
from steradian.core.validation import Value
from steradian.plans.stages import MOST_POINTS_OF_INTEREST, Proposal
from steradian.storage.repositories.scan_stages import StageState

Name = Annotated[str, StringConstraints(min_length=1, max_length=60)]
Text = Annotated[str, StringConstraints(max_length=200)]


class ScanRequest(Value):
    """Request for a scan: a plan to run on a scanner."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"plan_id": "p0123456789abcdef01234567", "labels": {"phantom": "yarn"}}]}
    )

    plan_id: str = Field(min_length=1, max_length=64, description="Identifier of the plan")
    scanner_id: str | None = Field(
        default=None, min_length=1, max_length=40, description="Scanner that runs it; optional if there is one scanner"
    )
    labels: dict[Name, Text] = Field(default_factory=dict, max_length=50, description="Texts of your own")
    completes: str | None = Field(
        default=None,
        min_length=1,
        max_length=64,
        description="A scan of the same plan that is over: the new one begins with its A-lines and measures what is"
        " missing, if film and scanner prove to be as they were; the earlier one stays as it is",
    )


class StageView(BaseModel):
    """Stage of a scan: its points, proposals and decision."""

    number: int = Field(description="1: the survey")
    state: StageState = Field(
        description="planned; proposed: the laser is off until a person decides or the rule does; decided; made: its"
        " points are those of the plan that is measured"
    )
    points: int | None = Field(description="Points of this stage, at most where it is not made; null: the plan's mask")
    decision: Literal["auto", "ask"] | None = Field(
        default=None, description="Whether the proposal is taken or a person asked"
    )
    points_of_interest: list[list[float]] = Field(default_factory=list, description="(P, 3) x, y and depth (m)")
    proposals: list[Proposal] = Field(default_factory=list, description="What the image before the stage showed")
    decided_by: str = Field(default="", description="auto (its rule), plan, or the name of the one who chose")
    plan_id: str | None = Field(default=None, description="Plan of the stages so far")
    mask_id: str | None = Field(default=None, description="Mask of that plan")
    made: str | None = Field(default=None, description="When its points were stored in the file")


class StageDecision(Value):
    """Decision on the points of interest of a stage: places, or proposals by their number."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"proposals": [1]}, {"points_of_interest": [[2.6e-3, -1.8e-3, 2.0e-3]]}],
            "minProperties": 1,
            "maxProperties": 1,
        }
    )

    points_of_interest: tuple[tuple[float, float, float], ...] = Field(
        default=(), min_length=1, max_length=MOST_POINTS_OF_INTEREST, description="x, y and depth (m) of each"
    )
    proposals: tuple[int, ...] = Field(
        default=(), min_length=1, max_length=MOST_POINTS_OF_INTEREST, description="Numbers of proposals, from 1"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if bool(self.points_of_interest) == bool(self.proposals):
            raise InvalidInput("points_of_interest", "both or neither", "points_of_interest or proposals")
        return self
