"""Job model: request, status and outcomes, independent of the queue engine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Any, TypeAlias

from steradian.core.exceptions import SteradianError
from steradian.storage.state_machines import DesiredJobState, ReconstructionState, is_terminal

if TYPE_CHECKING:
    from sqlalchemy.orm import Session

    from steradian.storage.db.tables import JobRow

MAX_ATTEMPTS = 3
"""How often a job is started when its process or its worker dies; an error it reports itself is final at once."""

MAX_INTERRUPTIONS = 20
"""How often a job is put back because what it stands on failed: a database, a folder, an earlier start still at it."""

DEFAULT_PRIORITY, LOWEST_PRIORITY = 100, 1000


class QueueUnavailable(SteradianError):
    """Error: the database of the job queue cannot be reached; a retry may succeed."""

    code = "queue-unavailable"


@dataclass(frozen=True)
class Requirements:
    """Memory, cores and GPU that a job requires of its worker.

    Attributes
    ----------
    memory
        Bytes of memory.
    cores
        Threads that a job of the worker may use.
    gpu
        Whether the job requires a GPU.
    """

    memory: int = 0
    cores: int = 0
    gpu: bool = False

    def __str__(self) -> str:
        named = {"memory": f"{self.memory} bytes of memory", "cores": f"{self.cores} cores", "gpu": "a GPU"}
        return " and ".join(text for name, text in named.items() if getattr(self, name)) or "nothing"


def requirements_of(row: JobRow) -> Requirements:
    """Return the worker requirements that are stored in a job's database row."""
    return Requirements(row.requires_memory, row.requires_cores, row.requires_gpu)


@dataclass(frozen=True)
class JobRequest:
    """Specification of a job to queue: kind, payload, priority, time limit, owner and requirements.

    Parameters
    ----------
    id
        Identifier; submitting the same one twice queues it once.
    kind
        Job kind, which selects the command that runs the job.
    payload
        Request for the handler, as plain JSON.
    priority
        0 to :data:`LOWEST_PRIORITY`; smaller ones run first; among equal ones, owners share the workers fairly
        (:mod:`steradian.jobs.queue.fair_queueing`).
    timeout
        Seconds after which the job fails; ``None``: the service's limit.
    principal
        Owner: the principal that requested the job.
    batch_id
        Batch of the job, if any.
    simulated
        Whether the job's scan came from a simulated scanner.
    requires
        Requirements on the worker.
    """

    id: str
    kind: str
    payload: Mapping[str, Any]
    priority: int = DEFAULT_PRIORITY
    timeout: float | None = None
    principal: str = "local"
    batch_id: str | None = None
    simulated: bool = False
    requires: Requirements = Requirements()


@dataclass(frozen=True)
class JobStatus:
    """Status of a job: state, progress, attempts, timestamps and error.

    Attributes
    ----------
    kind, payload
        Job kind and the request for its handler.
    scan_id, batch_id
        Scan and batch of the job, if any.
    simulated
        Whether the scan came from a simulated scanner.
    desired_state, reason
        State that a client requests, and the reason.
    revision
        Row version; increases with every change.
    priority, turn
        Priority and fair-queueing start tag; smaller priorities run first, and among equal ones smaller tags.
    requires
        Requirements on the worker.
    attempt
        Number of attempts, 0 before the first; a requeued attempt does not count.
    attempts, history
        Every attempt with its end; every change of state with principal, time and reason.
    stage, done, total
        Progress: name of the stage, and counts in a unit of the stage.
    error_code, error
        Code and text of the error of a failed job.
    request_id
        Identifier of the HTTP request that created the job, if any.
    result
        Report of the handler.
    """

    id: str
    state: ReconstructionState
    kind: str = ""
    payload: Mapping[str, Any] = field(default_factory=dict)
    scan_id: str | None = None
    batch_id: str | None = None
    simulated: bool = False
    desired_state: DesiredJobState = DesiredJobState.SUCCEEDED
    reason: str | None = None
    revision: int = 0
    priority: int = DEFAULT_PRIORITY
    turn: int = 0
    requires: Requirements = Requirements()
    attempt: int = 0
    attempts: list[dict[str, Any]] = field(default_factory=list)
    history: list[dict[str, Any]] = field(default_factory=list)
    stage: str | None = None
    done: int = 0
    total: int = 0
    error_code: str | None = None
    error: str | None = None
    request_id: str | None = None
    created: datetime | None = None
    started: datetime | None = None
    ended: datetime | None = None
    result: dict[str, Any] = field(default_factory=dict)

    @property
    def is_over(self) -> bool:
        """Whether the job is in a terminal state (succeeded, failed or cancelled)."""
        return is_terminal(self.state)


@dataclass(frozen=True)
class Succeeded:
    """Outcome of a successful job; ``on_commit`` runs in the transaction that records the success."""

    result: dict[str, Any]
    on_commit: Callable[[Session], object] | None = None


@dataclass(frozen=True)
class Failed:
    """Outcome of a job that failed with a permanent error and is not retried."""

    code: str
    message: str


@dataclass(frozen=True)
class Crashed:
    """Outcome of a job after its process ended without reporting a result: killed, out of memory or crashed."""

    message: str


@dataclass(frozen=True)
class Requeued:
    """Outcome of a job after a failure of its environment: the job is queued again, and the attempt does not count."""

    message: str


Outcome: TypeAlias = Succeeded | Failed | Crashed | Requeued
