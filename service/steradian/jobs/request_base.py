"""Base classes of the job requests, and the types of their fields."""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

from pydantic import Field, StringConstraints

from steradian.core.validation import Value, quantity_field
from steradian.jobs.job import DEFAULT_PRIORITY, LOWEST_PRIORITY
from steradian.scans.frames import FrameChoice

Identifier: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9]+$")]
"""A resource's identifier; it becomes part of a path."""
Name: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=60)]
Text: TypeAlias = Annotated[str, StringConstraints(max_length=200)]


class Required(Value):
    """Explicit requirements on a job's worker (memory, cores), in addition to those that follow from the job.

    Memory for its volume, and a GPU.
    """

    memory: int | None = Field(default=None, ge=1, le=2**50, description="Memory of the worker, at least (bytes)")
    cores: int | None = Field(default=None, ge=1, le=4096, description="Threads that its jobs may use, at least")


class JobRequestBase(Value):
    """Base class of job requests: priority, time limit and worker requirements."""

    priority: int = Field(default=DEFAULT_PRIORITY, ge=0, le=LOWEST_PRIORITY, description="Smaller ones run first")
    timeout: float | None = Field(default=None, gt=0, le=30 * 86_400, description="Longest it may run (s)")
    requires: Required = Field(default=Required(), description="Capabilities required of the worker")


def index_field(description: str = "Which volume of a series, from 0") -> Any:
    """Return the field that chooses a volume of a series."""
    return Field(default=None, ge=0, le=2**31, description=description)


class OfFrames(JobRequestBase):
    """Base class of job requests that select frames of a scan by number, wavelength or average."""

    frame: int | None = Field(
        default=None,
        ge=0,
        description="Which frame of a scan that has several",
    )
    wavelength: float | None = quantity_field(
        "m", "Of the excitation: its frames, or with average their mean", default=None, gt=0, le=1e-5
    )
    average: bool = Field(default=False, description="The mean of the frames at each wavelength")

    @property
    def frames(self) -> FrameChoice:
        """Selection of the scan's frames that are reconstructed."""
        return FrameChoice(self.frame, self.wavelength, self.average)
