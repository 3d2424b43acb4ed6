"""Registry of job kinds: request model, handler and resource."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

from steradian.core.json_encoding import to_jsonable
from steradian.jobs import request_versions as forms
from steradian.jobs import requests
from steradian.jobs.tasks import handlers as tasks
from steradian.jobs.tasks.context import JobContext

LIVE_KIND: Final = "live"


@dataclass(frozen=True)
class JobType:
    """One kind.

    Attributes
    ----------
    request
        Model of what it is asked.
    work
        Does it, in a worker's child process; returns figures, ``files`` among them where the job leaves files that
        others may have.
    resource
        ``reconstruction`` where it leaves a volume and stands behind ``/reconstructions`` too; its events say so.
    follows
        Stage in which it follows its scan, if it does: it takes no worker while the scan waits, and the service's limit
        on a job's time begins anew with each report of the stage.
    """

    request: type[requests.JobRequestBase]
    work: Callable[[JobContext, Any], dict[str, Any]]
    resource: Literal["reconstruction", "job"] = "job"
    follows: str | None = None

    def run(self, work: JobContext, request: Mapping[str, Any]) -> dict[str, Any]:
        """Check the request, do it and return plain JSON.

        Raises :class:`InvalidInput`, :class:`Conflict` for a request of a newer version, and what the work raises.
        """
        report: dict[str, Any] = to_jsonable(self.work(work, self.request.create(**forms.today(request))))
        return report


JOB_TYPES: Final[Mapping[str, JobType]] = MappingProxyType(
    {
        "reconstruction": JobType(requests.ReconstructionRequest, tasks.reconstruct, "reconstruction"),
        LIVE_KIND: JobType(requests.ReconstructionRequest, tasks.reconstruct_live, "reconstruction", follows="A-lines"),
        "what-if": JobType(requests.ReconstructionRequest, tasks.reconstruct_subset, "reconstruction"),
        "sound-speed": JobType(requests.SoundSpeedRequest, tasks.scan_sound_speed),
        "quality": JobType(requests.QualityRequest, tasks.compare_volumes),
        "width": JobType(requests.WidthRequest, tasks.measure_object),
        "export": JobType(requests.ExportRequest, tasks.export),
        "import": JobType(requests.ImportRequest, tasks.import_recording),
    }
)
"""Each kind by the name under which it is queued."""


LIVE_KINDS: Final = tuple(name for name, kind in JOB_TYPES.items() if kind.follows)
"""Kinds that follow a scan."""


def resource_of(kind: str) -> str:
    """Name the resource as which a job of a kind is known."""
    return JOB_TYPES[kind].resource if kind in JOB_TYPES else "job"
