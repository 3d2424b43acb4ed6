"""From the engine's words about a job to ours; knows the engine's vocabulary, not the engine."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Final, Protocol

from steradian.storage.jobs import JobStatus
from steradian.storage.states import ReconstructionState

_State = ReconstructionState
_STATES: Final = {
    "ENQUEUED": _State.QUEUED,
    "DELAYED": _State.QUEUED,
    "PENDING": _State.RUNNING,
    "CANCELLED": _State.CANCELLED,
    "ERROR": _State.FAILED,
    "MAX_RECOVERY_ATTEMPTS_EXCEEDED": _State.FAILED,
}


class EngineStatus(Protocol):
    """What is used of the engine's row of a job; times are milliseconds since the epoch."""

    workflow_id: str
    status: Any
    output: Any
    error: Any
    created_at: int | None
    dequeued_at: int | None
    completed_at: int | None


def to_status(found: EngineStatus, progress: Mapping[str, Any], running: bool) -> JobStatus:
    """Translate.

    Parameters
    ----------
    progress
        The job's last progress event.
    running
        Whether a process of the job still lives.
    """
    output: Mapping[str, Any] = found.output if isinstance(found.output, dict) else {}
    state = _STATES.get(found.status)
    if state is None:
        state = _State.SUCCEEDED if "result" in output else _State.FAILED
    elif state is _State.CANCELLED and running:
        state = _State.CANCELLING
    code, message = output.get("code"), output.get("message")
    if state is _State.FAILED and code is None:
        code, message = "internal", str(found.error or found.status)
    return JobStatus(
        id=found.workflow_id,
        state=state,
        attempt=int(output.get("attempt", progress.get("attempt", 0))),
        stage=progress.get("stage"),
        done=int(progress.get("done", 0)),
        total=int(progress.get("total", 0)),
        error_code=code,
        error=message,
        created=_time(found.created_at),
        started=_time(found.dequeued_at),
        ended=_time(found.completed_at),
        result=dict(output.get("result", {})),
    )


def _time(milliseconds: int | None) -> datetime | None:
    return None if milliseconds is None else datetime.fromtimestamp(milliseconds / 1000, UTC)
