"""Response schemas of a queued job's position and requirements."""

from __future__ import annotations

from dataclasses import asdict
from datetime import datetime
from typing import Self

from pydantic import BaseModel, Field

from steradian.jobs.job import Requirements
from steradian.jobs.queue.estimates import QueueEstimate


class RequirementsView(BaseModel):
    """Requirements of a job on its worker: memory, cores and GPU."""

    memory: int = Field(description="Bytes; of a volume whose size is known, what its values alone take")
    cores: int = Field(description="Threads that the worker's jobs may use")
    gpu: bool

    @classmethod
    def of(cls, wanted: Requirements) -> Self:
        """Return the view of a job's requirements."""
        return cls(**asdict(wanted))


class QueueView(BaseModel):
    """Queue position of a job that has not ended."""

    position: int | None = Field(
        description="1: the next that begins; null when it runs, or waits for its scan or for another worker"
    )
    expected_end: datetime | None = Field(
        description="From the median duration of recent jobs of its kind; null when that cannot be said: too few were"
        " done, a worker is idle, or it takes longer than it should"
    )
    awaited: str | None = Field(
        description="The worker that it waits for; null where one that is present can do it, or none is at all",
        examples=["a worker with a GPU; present: 16000000000 bytes of memory, 8 cores, no GPU"],
    )

    @classmethod
    def of(cls, seen: QueueEstimate | None) -> Self | None:
        """Return the view of a queue estimate; ``None`` for a job that has ended."""
        return None if seen is None else cls(**asdict(seen))
