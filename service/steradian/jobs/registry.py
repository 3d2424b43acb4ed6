"""Registry of job kinds: request model, handler and resource."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

from steradian.core.json_encoding import plain
from steradian.jobs import request_versions as forms
from steradian.jobs import requests
from steradian.jobs.tasks import handlers as tasks
from steradian.jobs.tasks.context import Work

LIVE: Final = "live"


@dataclass(frozen=True)
class JobKind:
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

    request: type[requests.Request]
    work: Callable[[Work, Any], dict[str, Any]]
    resource: Literal["reconstruction", "job"] = "job"
    follows: str | None = None

    def run(self, work: Work, request: Mapping[str, Any]) -> dict[str, Any]:
        """Check the request, do it and return plain JSON.

        Raises :class:`InvalidInput`, :class:`Conflict` for a request of a newer version, and what the work raises.
        """
        report: dict[str, Any] = plain(self.work(work, self.request.create(**forms.today(request))))
        return report


KINDS: Final[Mapping[str, JobKind]] = MappingProxyType(
    {
        "reconstruction": JobKind(requests.ReconstructionRequest, tasks.reconstruct, "reconstruction"),
        LIVE: JobKind(requests.ReconstructionRequest, tasks.follow, "reconstruction", follows="A-lines"),
        "what-if": JobKind(requests.ReconstructionRequest, tasks.look_through, "reconstruction"),
        "sound-speed": JobKind(requests.SoundSpeedRequest, tasks.scan_speeds),
        "quality": JobKind(requests.QualityRequest, tasks.compare_volumes),
        "width": JobKind(requests.WidthRequest, tasks.measure_object),
        "export": JobKind(requests.ExportRequest, tasks.export),
        "import": JobKind(requests.ImportRequest, tasks.import_recording),
    }
)
"""Each kind by the name under which it is queued."""


FOLLOWING: Final = tuple(name for name, kind in KINDS.items() if kind.follows)
"""Kinds that follow a scan."""


def resource_of(kind: str) -> str:
    """Name the resource as which a job of a kind is known."""
    return KINDS[kind].resource if kind in KINDS else "job"
