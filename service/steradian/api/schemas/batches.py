"""Request and response schemas of batches: sweeps over parameters, masks or frames."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from datetime import datetime
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field

from steradian.api.http.urls import link
from steradian.api.schemas.reports import ReportView
from steradian.core.exceptions import InvalidInput
from steradian.core.validation import Value
from steradian.jobs.job import DEFAULT_PRIORITY, LOWEST_PRIORITY, JobStatus
from steradian.jobs.reconstruction_request import ReconstructionRequest, Through
from steradian.jobs.request_base import Identifier, Required
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.storage.db.tables import BatchRow
from steradian.storage.state_machines import BatchState

MAX_JOBS = 200
_SCAN = "s01jz0000000000000000000000"
_EXAMPLES: list[Any] = [
    {"scan_id": _SCAN, "vary": {"sound_speed": [1480, 1490, 1500]}, "parameters": {"modes": 226}},
    {"scan_id": _SCAN, "vary": {"mask_id": ["m0123456789abcdef01234567", "m1123456789abcdef01234567"]}},
    {"scan_id": _SCAN, "each": "wavelength"},
]


class BatchRequest(Value):
    """Request of a batch: one job for every combination of the varied values."""

    model_config = ConfigDict(json_schema_extra={"examples": _EXAMPLES})

    scan_id: Identifier = Field(description="Identifier of the scan")
    vary: dict[str, list[Any]] = Field(
        default_factory=dict,
        description="Values of each swept parameter; mask_id: subset masks (what-if), frame: frames",
    )
    each: Literal["wavelength", "frame"] | None = Field(
        default=None, description="A job for each excitation wavelength of the scan (its first frame), or each frame"
    )
    parameters: dict[str, Any] = Field(default_factory=dict, description="Parameters common to all jobs")
    points: Literal["nearest", "exact"] = Field(default="nearest", description="Options for subset masks")
    priority: int = Field(default=DEFAULT_PRIORITY, ge=0, le=LOWEST_PRIORITY, description="Smaller ones run first")
    requires: Required = Field(default=Required(), description="Capabilities required of each job's worker")

    def expand_grid(self, excitation: list[float]) -> dict[str, list[Any]]:
        """Return the values of each swept parameter, with ``each`` expanded to frame numbers.

        ``excitation`` is the wavelength of each frame.
        """
        if self.each is None:
            return self.vary
        first: dict[float, int] = {}
        for number, wavelength in enumerate(excitation):
            first.setdefault(wavelength, number)
        return self.vary | {"frame": list(range(len(excitation))) if self.each == "frame" else list(first.values())}

    def to_job_requests(self, vary: dict[str, list[Any]]) -> list[ReconstructionRequest]:
        """Return one job request per combination of values.

        Raises :class:`InvalidInput` for too many or an invalid one.
        """
        count, known = 1, [*ReconstructionParameters.model_fields, *_BESIDE]
        for name, values in vary.items():
            if name not in known:
                raise InvalidInput("vary", name, ", ".join(known))
            count *= len(values)
        if not vary or not 1 <= count <= MAX_JOBS:
            raise InvalidInput("vary", f"{count} jobs" if vary else "empty", f"1 to {MAX_JOBS} jobs")
        if "mask_id" in vary and "frame" in vary:
            raise InvalidInput("vary", "mask_id and frame", "one of the two")
        return [self._one(dict(zip(vary, values, strict=True))) for values in itertools.product(*vary.values())]

    def _one(self, chosen: dict[str, Any]) -> ReconstructionRequest:
        beside = SweepOptions.create(**{name: chosen.pop(name) for name in _BESIDE if name in chosen})
        parameters = ReconstructionParameters.create(**self.parameters | chosen)
        through = None if beside.mask_id is None else Through(mask_id=beside.mask_id, points=self.points)
        about: dict[str, Any] = {"through": through, "frame": beside.frame}
        about |= {"priority": self.priority, "requires": self.requires}
        return ReconstructionRequest.create(scan_id=self.scan_id, parameters=parameters, **about)


class SweepOptions(Value):
    """Request fields that may vary besides reconstruction parameters."""

    mask_id: Identifier | None = None
    frame: int | None = Field(default=None, ge=0)


_BESIDE = tuple(SweepOptions.model_fields)


class MemberView(BaseModel):
    """Job of a batch, as shown in the response."""

    id: str
    varied: dict[str, Any]
    state: str
    progress: float = Field(description="0 to 1 within the present stage")
    figures: ReportView | None = Field(description="Its report, when it has succeeded")


class BatchView(BaseModel):
    """Batch: its state and the states of its jobs."""

    id: str
    scan_id: str
    vary: dict[str, Any]
    parameters: dict[str, Any]
    state: BatchState = Field(
        description="succeeded when all jobs have; failed or cancelled when all are over and one is; of jobs that are"
        " not kept any more nothing is known, and a batch of nothing else is forgotten"
    )
    counts: dict[str, int] = Field(description="Jobs in each state", examples=[{"queued": 2, "succeeded": 1}])
    jobs: list[MemberView]
    created: datetime
    links: dict[str, str]

    @classmethod
    def of(cls, row: BatchRow, jobs: list[JobStatus]) -> Self:
        """Return the view of a batch from its row and jobs."""
        counts = Counter(str(job.state) for job in jobs)
        if forgotten := math.prod(len(values) for values in row.vary.values()) - len(jobs):
            counts["forgotten"] = forgotten
        here = link(f"/batches/{row.id}")
        return cls(
            id=row.id,
            scan_id=row.scan_id,
            vary=row.vary,
            parameters=row.parameters,
            state=BatchState.of(counts),
            counts=dict(counts),
            jobs=[_member(row, job) for job in jobs],
            created=row.created,
            links={"self": here, "scan": link(f"/scans/{row.scan_id}")},
        )


def _member(batch: BatchRow, job: JobStatus) -> MemberView:
    asked = {**job.payload["parameters"], **job.payload, **(job.payload.get("through") or {})}
    varied = {name: asked.get(name) for name in batch.vary}
    progress = 1.0 if job.is_over else job.done / job.total if job.total else 0.0
    result = ReportView.model_validate(job.result) if job.result else None
    return MemberView(id=job.id, varied=varied, state=job.state, progress=progress, figures=result)
