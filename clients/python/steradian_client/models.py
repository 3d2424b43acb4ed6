"""Answers of the service, typed; unknown fields of a newer service are ignored."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import BaseModel, ConfigDict


class Answer(BaseModel):
    """Root of all answers."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class Progress(Answer):
    """How far work has come; ``total`` is 0 while unknown."""

    stage: str | None
    done: int
    total: int


class Problem(Answer):
    """Why work failed."""

    code: str
    detail: str


class Mask(Answer):
    """A mask without its points; lengths in metres."""

    id: str
    arrangement: dict[str, Any]
    aperture: float
    depth: float | None
    count: int
    weight_ratio: float
    sensed_area: float | None = None


class Plan(Answer):
    """A plan and what it costs; SI units."""

    id: str
    mask_id: str
    pulse_rate: float
    averages: int
    samples: int
    sampling_interval: float
    sound_speed: float
    order: str
    preview: dict[str, Any]


class Scan(Answer):
    """A scan: where it stands."""

    id: str
    plan_id: str
    simulated: bool
    state: str
    progress: Progress
    error: Problem | None
    summary: dict[str, Any] | None
    created: datetime
    started: datetime | None
    ended: datetime | None

    @property
    def is_over(self) -> bool:
        """Whether the scan changes no more by itself."""
        return self.state in {"complete", "partial", "aborted", "failed", "interrupted"}

    @property
    def is_good(self) -> bool:
        """Whether it ended with data to use: every point, or those measured before it was stopped."""
        return self.state in {"complete", "partial"}


class Reconstruction(Answer):
    """A reconstruction: what was asked and how far it is."""

    id: str
    scan_id: str
    parameters: dict[str, Any]
    state: str
    attempt: int
    progress: Progress
    error: Problem | None
    report: dict[str, Any] | None
    created: datetime
    started: datetime | None
    ended: datetime | None

    @property
    def is_over(self) -> bool:
        """Whether the job changes no more."""
        return self.state in {"succeeded", "failed", "cancelled"}

    @property
    def is_good(self) -> bool:
        """Whether it left a volume."""
        return self.state == "succeeded"
