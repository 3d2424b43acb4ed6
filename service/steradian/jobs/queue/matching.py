"""Matching of jobs to workers: worker capabilities, job requirements and worker registration.

A job says what it requires: memory and cores if it states them, memory at least for its volume, a GPU if it insists on
one. A worker notes what it has in the database every few seconds and takes jobs whose requirements it meets, in the
common order; those that it cannot do are passed over and wait for another worker.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from typing import Final

from sqlalchemy import ColumnElement, delete, false, func, not_, or_, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from steradian.core.exceptions import InvalidInput
from steradian.core.settings import Settings
from steradian.core.system_resources import total_memory
from steradian.jobs.job import Requirements, requirements_of
from steradian.jobs.registry import LIVE_KINDS
from steradian.storage.db.database import Database
from steradian.storage.db.tables import JobRow, ScannerRow, ScanRow, WorkerRow
from steradian.storage.db.timestamps_and_ids import Clock, utc_now
from steradian.storage.repositories.scanner_lease_and_stop import PRESENT
from steradian.storage.state_machines import ReconstructionState

REFRESH_INTERVAL: Final = 10.0
"""Seconds between two notes of what a worker has."""
PRESENCE_TIMEOUT: Final = timedelta(minutes=2)
"""A worker that has noted nothing for so long counts as gone."""
RECENT_WINDOW: Final = timedelta(hours=1)
"""A worker that was here so lately may come back, as after a restart."""
EXPIRY: Final = timedelta(days=1)
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Capabilities:
    """Capabilities of a worker: memory, cores, GPU, and the scanner whose live jobs it runs.

    Attributes
    ----------
    memory
        Bytes of memory of the machine, container or setting; ``None`` where the system does not report them.
    cores
        Threads that a job may use.
    gpu
        Name of the GPU, if it uses one.
    scanner_id
        Scanner whose live jobs are the only ones that the worker runs; ``None``: the worker runs all jobs.
    """

    memory: int | None
    cores: int
    gpu: str | None = None
    scanner_id: str | None = None

    @classmethod
    def of_this_machine(cls, settings: Settings, gpu: str | None) -> Capabilities:
        """Return the capabilities of a worker with these settings on this machine."""
        memory = settings.worker_memory_bytes or total_memory()
        return cls(memory, settings.threads_per_job, gpu, settings.scanner_id if settings.is_scanner_node else None)

    def satisfies(self, wanted: Requirements) -> bool:
        """Return whether the worker meets a job's requirements."""
        has_room = self.memory is None or wanted.memory <= self.memory
        return has_room and wanted.cores <= self.cores and (self.gpu is not None or not wanted.gpu)

    def __str__(self) -> str:
        memory = "memory of unknown size" if self.memory is None else f"{self.memory} bytes of memory"
        return f"{memory}, {self.cores} {'core' if self.cores == 1 else 'cores'}, {self.gpu or 'no GPU'}"


def unsatisfied_clause(has: Capabilities) -> ColumnElement[bool]:
    """Return the SQL condition that selects the jobs whose requirements exceed a worker's capabilities."""
    without_gpu = JobRow.requires_gpu if has.gpu is None else false()
    too_large = false() if has.memory is None else JobRow.requires_memory > has.memory
    return or_(too_large, JobRow.requires_cores > has.cores, without_gpu)


def present_workers(session: Session, now: datetime, within: timedelta = PRESENCE_TIMEOUT) -> dict[str, Capabilities]:
    """Return the capabilities of the workers seen within the time ``within``, by worker name.

    Hosts' clocks need not agree to the second; one that is minutes ahead or behind is not believed.
    """
    heard = WorkerRow.seen.between(now - within, now + PRESENCE_TIMEOUT)
    rows = session.scalars(select(WorkerRow).where(heard).order_by(WorkerRow.name))
    return {row.name: Capabilities(row.memory, row.cores, row.gpu, row.scanner_id) for row in rows}


def dedicated_scanner(session: Session, kind: str, scan_id: str | None) -> str | None:
    """Return the scanner whose own workers run a live job; ``None`` for other jobs or a finished scan."""
    if kind not in LIVE_KINDS:
        return None
    scan = (ScanRow.scanner_id == ScannerRow.id) & (ScanRow.id == scan_id) & ScanRow.ended.is_(None)
    return session.scalar(select(ScannerRow.id).join(ScanRow, scan).where(ScannerRow.follows, PRESENT))


def eligible_workers(scanner_id: str | None, known: Mapping[str, Capabilities]) -> list[Capabilities]:
    """Return the workers that may run a job: all general workers and those of the given scanner's node."""
    return [has for has in known.values() if has.scanner_id in {None, scanner_id}]


def require_satisfiable(session: Session, now: datetime, scanner_id: str | None, wanted: Requirements) -> None:
    """Reject a job whose requirements no recently seen worker meets; without recent workers accept all jobs.

    Parameters
    ----------
    scanner_id
        The job's :func:`dedicated_scanner`.

    Raises
    ------
    InvalidInput
        Naming the first requirement that none of them meets.
    """
    known = eligible_workers(scanner_id, present_workers(session, now, RECENT_WINDOW))
    if not known or any(has.satisfies(wanted) for has in known):
        return
    about = {
        "requires.memory": (Requirements(memory=wanted.memory), wanted.memory),
        "requires.cores": (Requirements(cores=wanted.cores), wanted.cores),
        "parameters.device": (Requirements(gpu=wanted.gpu), "gpu"),
    }
    for field, (one, value) in about.items():
        if not any(has.satisfies(one) for has in known):
            raise InvalidInput(field, value, f"what one of the workers has: {_listed(known)}")
    raise InvalidInput("requires", str(wanted), f"what one of the workers has at once: {_listed(known)}")


def satisfiable_clause(present: Sequence[Capabilities]) -> ColumnElement[bool]:
    """Return the SQL condition that selects the jobs which at least one of the given workers can run."""
    return or_(*(not_(unsatisfied_clause(has)) for has in present)) if present else false()


def count_unsatisfiable(session: Session, present: Mapping[str, Capabilities]) -> int:
    """Count the queued jobs that no present worker can run; without present workers the count is 0."""
    waits, growing = JobRow.state == ReconstructionState.QUEUED, JobRow.kind.in_(LIVE_KINDS)
    count = sum(
        missing_capability(dedicated_scanner(session, row.kind, row.scan_id), requirements_of(row), present) is not None
        for row in session.scalars(select(JobRow).where(waits, growing))
    )
    if able := eligible_workers(None, present):
        count += session.scalar(select(func.count()).where(waits, not_(growing), not_(satisfiable_clause(able)))) or 0
    return count


def missing_capability(scanner_id: str | None, wanted: Requirements, known: Mapping[str, Capabilities]) -> str | None:
    """Describe the requirements that no present worker meets; ``None`` if a present worker can run the job."""
    present = eligible_workers(scanner_id, known)
    if not present or any(has.satisfies(wanted) for has in present):
        return None
    return f"a worker with {wanted}; present: {_listed(present)}"


class WorkerRegistration:
    """Heartbeat that records a worker's capabilities in the database every few seconds."""

    def __init__(self, database: Database, name: str, has: Capabilities, clock: Clock = utc_now) -> None:
        self._database, self._name, self._has, self._clock = database, name, has, clock

    def start(self) -> None:
        """Record the capabilities now and start the thread that records them periodically until the process ends."""
        self._try()
        threading.Thread(target=self._keep, daemon=True, name="notice").start()

    def publish(self) -> None:
        """Record this worker's capabilities and delete the rows of workers not seen recently."""
        now = self._clock()
        row = WorkerRow(name=self._name, seen=now, **asdict(self._has))
        with self._database.write() as session:
            session.execute(delete(WorkerRow).where(WorkerRow.seen < now - EXPIRY))
            session.merge(row)

    def _try(self) -> None:
        try:
            self.publish()
        except SQLAlchemyError as error:  # the next one comes soon
            _log.debug("this worker's capabilities are not recorded: %s", error)

    def _keep(self) -> None:
        pause = threading.Event()
        while not pause.wait(REFRESH_INTERVAL):
            self._try()


def _listed(known: Sequence[Capabilities]) -> str:
    return "; ".join(sorted({str(has) for has in known}))
