"""The kinds of jobs, each with its request, what does it, and the folder's files that others may have."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from steradian.jobs import requests, tasks
from steradian.jobs.tasks import Work
from steradian.validation import Value

LIVE, RECONSTRUCTION, WHAT_IF = "live", "reconstruction", "what-if"
VOLUMES: Final = frozenset({LIVE, RECONSTRUCTION, WHAT_IF})
"""Kinds that leave a volume: those behind ``/reconstructions``."""
_ABOUT = frozenset({"kind", "job", "data", "scan_id", "batch_id"})
"""What a payload may hold beside the request."""


@dataclass(frozen=True)
class JobKind:
    """One kind.

    Attributes
    ----------
    request
        Model of the payload.
    work
        Does it, in a worker's child process; returns figures as plain JSON, ``files`` among them where the job leaves
        files that others may have.
    """

    request: type[Value]
    work: Callable[[Work, Any], dict[str, Any]]

    def run(self, work: Work, payload: Mapping[str, Any]) -> dict[str, Any]:
        """Check the request and do it; raises :class:`InvalidInput` and whatever the work raises."""
        fields = {name: value for name, value in payload.items() if name in self.request.model_fields}
        unknown = {
            name: value
            for name, value in payload.items()
            if name not in self.request.model_fields and name not in _ABOUT
        }
        return self.work(work, self.request.create(**fields, **unknown))


KINDS: Final[Mapping[str, JobKind]] = MappingProxyType(
    {
        RECONSTRUCTION: JobKind(requests.Reconstruction, tasks.reconstruct),
        LIVE: JobKind(requests.Live, tasks.follow),
        WHAT_IF: JobKind(requests.WhatIf, tasks.look_through),
        "sound-speed": JobKind(requests.SoundSpeed, tasks.scan_speeds),
        "quality": JobKind(requests.Quality, tasks.compare_volumes),
        "export": JobKind(requests.Export, tasks.export),
        "import": JobKind(requests.ImportAs, tasks.import_recording),
    }
)
"""Each kind by the name under which it is queued."""
