"""Registry of job kinds: request model, handler and resource."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from steradian.jobs.tasks import handlers, reconstruction_handlers  # noqa: F401 - importing registers them
from steradian.jobs.tasks.job_type import JOB_TYPES as _JOB_TYPES
from steradian.jobs.tasks.job_type import JobType

JOB_TYPES: Final[Mapping[str, JobType]] = MappingProxyType(_JOB_TYPES)
"""Job kinds by the name under which they are queued."""
LIVE_KIND: Final = reconstruction_handlers.LIVE_KIND
LIVE_KINDS: Final = tuple(name for name, kind in JOB_TYPES.items() if kind.follows)
"""Kinds that follow a scan."""
VOLUME_KINDS: Final = tuple(name for name, kind in JOB_TYPES.items() if kind.resource == "reconstruction")
"""Kinds that write a volume."""


def resource_of(kind: str) -> str:
    """Return the API resource that represents jobs of a kind: reconstruction or job."""
    return JOB_TYPES[kind].resource if kind in JOB_TYPES else "job"
