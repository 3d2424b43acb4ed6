"""Job type: request model, handler and resource of a job kind, with the decorator that registers one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeVar

from steradian.core.json_encoding import to_jsonable
from steradian.jobs import request_versions as forms
from steradian.jobs.request_base import JobRequestBase
from steradian.jobs.tasks.context import JobContext

Resource = Literal["reconstruction", "job"]
Request = TypeVar("Request", bound=JobRequestBase)
Handler = Callable[[JobContext, Request], dict[str, Any]]
JOB_TYPES: Final[dict[str, JobType]] = {}
"""Job kinds by name, in the order of their handlers."""


@dataclass(frozen=True)
class JobType:
    """Registry entry of a job kind: request model, handler and API resource.

    Attributes
    ----------
    request
        Model of the request.
    work
        Handler, run in a worker's child process; returns figures, and under ``files`` names of files for clients.
    resource
        ``reconstruction`` for jobs that write a volume and are listed under ``/reconstructions`` too.
    follows
        Stage in which the job follows a running scan, or None. Such a job takes no worker while the scan waits, and
        each report of the stage restarts the service's limit on a job's time.
    """

    request: type[JobRequestBase]
    work: Callable[[JobContext, Any], dict[str, Any]]
    resource: Literal["reconstruction", "job"] = "job"
    follows: str | None = None

    def run(self, work: JobContext, request: Mapping[str, Any]) -> dict[str, Any]:
        """Validate a stored request, run the handler and return its report as JSON-compatible values.

        Raises :class:`InvalidInput`, :class:`Conflict` for a request of another version, and the handler's errors.
        """
        report: dict[str, Any] = to_jsonable(self.work(work, self.request.create(**forms.current(request))))
        return report


def handles(
    request: type[Request], kind: str | None = None, *, resource: Resource = "job", follows: str | None = None
) -> Callable[[Handler[Request]], Handler[Request]]:
    """Return a decorator that registers a function as the handler of a job kind.

    The other arguments are those of :class:`JobType`. ``kind`` defaults to that of the request model. The decorator
    raises ValueError for a kind that has a handler.
    """
    name = kind or request.model_fields["kind"].default

    def register(handler: Handler[Request]) -> Handler[Request]:
        if name in JOB_TYPES:
            raise ValueError(f"kind {name} has two handlers")
        JOB_TYPES[name] = JobType(request, handler, resource, follows)
        return handler

    return register
