"""Job model: request, status and outcomes, independent of the queue engine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Any, TypeAlias

from steradian.core.exceptions import SteradianError
from steradian.storage.states import DesiredJobState, ReconstructionState, is_terminal

if TYPE_CHECKING:
    from sqlalchemy.orm import Session

    from steradian.storage.db.tables import JobRow

MAX_ATTEMPTS = 3
"""How often a job is started when its process or its worker dies; an error it reports itself is final at once."""

MAX_INTERRUPTIONS = 20
"""How often a job is put back because what it stands on failed: a database, a folder, an earlier start still at it."""

DEFAULT_PRIORITY, LOWEST_PRIORITY = 100, 1000


class QueueUnavailable(SteradianError):
    """The job queue cannot be reached; trying again may help."""

    code = "queue-unavailable"


@dataclass(frozen=True)
class Requirements:
    """Requirements of a job on its worker.

    Attributes
    ----------
    memory
        Bytes.
    cores
        Threads that a job of the worker may use.
    gpu
        Whether it has to be done on a GPU.
    """

    memory: int = 0
    cores: int = 0
    gpu: bool = False

    def __str__(self) -> str:
        named = {"memory": f"{self.memory} bytes of memory", "cores": f"{self.cores} cores", "gpu": "a GPU"}
        return " and ".join(text for name, text in named.items() if getattr(self, name)) or "nothing"


def requirements_of(row: JobRow) -> Requirements:
    """Parse the requirements in a job's row."""
    return Requirements(row.requires_memory, row.requires_cores, row.requires_gpu)


@dataclass(frozen=True)
class JobRequest:
    """A job to queue.

    Parameters
    ----------
    id
        Identifier; submitting the same one twice queues it once.
    kind
        Which program runs it (see the worker's table of commands).
    payload
        What that program reads, plain JSON.
    priority
        0 to :data:`LOWEST_PRIORITY`; smaller ones run first, and among equal ones those who asked take turns
        (:mod:`steradian.jobs.queue.fair_queueing`).
    timeout
        Seconds after which it has failed; ``None``: the service's limit.
    principal
        Who asked for it.
    batch_id
        The batch it belongs to.
    promised
        Bytes of the disk that it may write.
    requires
        What its worker must have.
    """

    id: str
    kind: str
    payload: Mapping[str, Any]
    priority: int = DEFAULT_PRIORITY
    timeout: float | None = None
    principal: str = "local"
    batch_id: str | None = None
    promised: int = 0
    requires: Requirements = Requirements()


@dataclass(frozen=True)
class JobStatus:
    """Status of a job: state, progress, attempts, timestamps and error.

    Attributes
    ----------
    kind, payload
        Which program runs it and what that was asked.
    desired_state, reason
        What a person wants of it and why.
    revision
        Grows with every change.
    priority, turn
        Smaller priorities run first, and among equal ones smaller turns.
    requires
        What its worker must have.
    attempt
        1 for the first start, 0 before it; a start that was put back does not count.
    attempts, history
        Every start with its end, every change of state with who, when and why.
    stage, done, total
        What it works on and how far it is, in a unit of the stage's own.
    error_code, error
        Why it failed.
    request_id
        The HTTP request that asked for it, if one did.
    result
        What it left on its last line of output.
    """

    id: str
    state: ReconstructionState
    kind: str = ""
    payload: Mapping[str, Any] = field(default_factory=dict)
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
        """Whether nothing will change any more."""
        return is_terminal(self.state)


@dataclass(frozen=True)
class Succeeded:
    """Success of a job's process; ``announce`` commits its results in the transaction that records the success."""

    result: dict[str, Any]
    on_commit: Callable[[Session], object] | None = None


@dataclass(frozen=True)
class Failed:
    """A job failed for a reason that another attempt would not change."""

    code: str
    message: str


@dataclass(frozen=True)
class Crashed:
    """A job's process ended without a word: killed, out of memory, crashed."""

    message: str


@dataclass(frozen=True)
class Requeued:
    """Failure of a job's environment, not of the job: it is requeued, and the attempt does not count."""

    message: str


Outcome: TypeAlias = Succeeded | Failed | Crashed | Requeued
