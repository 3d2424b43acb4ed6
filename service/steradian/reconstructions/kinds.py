"""The kinds of jobs, each with what it is asked, what does it, and the folder's files that others may have."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from steradian.reconstructions import asked, tasks
from steradian.reconstructions.tasks import Work
from steradian.validation import Value

LIVE, RECONSTRUCTION, WHAT_IF = "live", "reconstruction", "what-if"
VOLUMES: Final = frozenset({LIVE, RECONSTRUCTION, WHAT_IF})
"""Kinds that leave a volume: those behind ``/reconstructions``."""
_ABOUT = frozenset({"kind", "job", "data", "scan_id", "batch_id"})
"""What a payload may hold beside what is asked."""


@dataclass(frozen=True)
class JobKind:
    """One kind.

    Attributes
    ----------
    asked
        Model of the payload.
    work
        Does it, in a worker's child process; returns figures as plain JSON, ``files`` among them where the job leaves
        files that others may have.
    """

    asked: type[Value]
    work: Callable[[Work, Any], dict[str, Any]]

    def run(self, work: Work, payload: Mapping[str, Any]) -> dict[str, Any]:
        """Check what is asked and do it; raises :class:`InvalidInput` and whatever the work raises."""
        fields = {name: value for name, value in payload.items() if name in self.asked.model_fields}
        unknown = {
            name: value for name, value in payload.items() if name not in self.asked.model_fields and name not in _ABOUT
        }
        return self.work(work, self.asked.create(**fields, **unknown))


KINDS: Final[Mapping[str, JobKind]] = MappingProxyType(
    {
        RECONSTRUCTION: JobKind(asked.Reconstruction, tasks.reconstruct),
        LIVE: JobKind(asked.Live, tasks.follow),
        WHAT_IF: JobKind(asked.WhatIf, tasks.imagine),
        "sound-speed": JobKind(asked.SoundSpeed, tasks.scan_speeds),
        "quality": JobKind(asked.Quality, tasks.judge),
        "export": JobKind(asked.Export, tasks.export),
        "import": JobKind(asked.ImportAs, tasks.take_in),
    }
)
"""Each kind by the name under which it is queued."""
