"""Composition root of the API: settings, repositories, queue and background threads."""

from __future__ import annotations

import asyncio
import gc
import logging
import threading
import time
from dataclasses import replace
from datetime import timedelta
from typing import TYPE_CHECKING

from sqlalchemy.orm import Session

from steradian.api.background.batcher import BatchLoader
from steradian.api.background.fault_clearing import FaultClearingService
from steradian.api.background.local_emergency_stop import EmergencyStopController
from steradian.api.background.peers import PeerRegistry
from steradian.api.background.periodic_refresh import PeriodicRefresher
from steradian.api.background.process_pool import ProcessPool
from steradian.api.background.retention import apply_retention
from steradian.api.background.scan_row_changes import RowDeltaTracker
from steradian.api.background.stop_relay import EmergencyStopRelay
from steradian.core.settings import Settings
from steradian.jobs.job import JobRequest, JobStatus, QueueUnavailable
from steradian.jobs.queue.estimates import QueueEstimate, forecast
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.jobs.queue.matching import dedicated_scanner, require_satisfiable
from steradian.security.keys import KeyStore
from steradian.security.sessions import SessionStore
from steradian.security.stop_tickets import StopTickets, shared_secret, stored_secret
from steradian.storage.blobs.object_store import arrays_of
from steradian.storage.capacity.reserve import DiskReserve
from steradian.storage.capacity.usage import usage
from steradian.storage.data_dir.emergency_latch import EmergencyLatch
from steradian.storage.data_dir.fault_requests import ClearFaultRequest
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.data_dir.scanner_status import StatusBlock
from steradian.storage.db.advisory_locks import AdvisoryLock, LockState
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.db.tables import JobRow
from steradian.storage.db.timestamps_and_ids import Clock, utc_now
from steradian.storage.maintenance.clock_trust import TrustedClock
from steradian.storage.repositories.batches import BatchRepository
from steradian.storage.repositories.deletion import DeletionService, InUse, remove_files
from steradian.storage.repositories.event_log import EventLog
from steradian.storage.repositories.idempotency import IdempotencyStore
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.measurements import MeasurementRepository
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import is_terminal

if TYPE_CHECKING:
    from steradian.jobs.queue.queue_client import JobQueue

_log = logging.getLogger(__name__)
QUEUE_PATIENCE, STORE_PATIENCE = 30.0, timedelta(seconds=5)
"""How long a request waits for the queue (s), and for an object store that does not answer."""
RECONCILE_EVERY, TIDY_EVERY, REOPEN_EVERY = 1.0, 600.0, 5.0
CARETAKER_SHUTDOWN_TIMEOUT = 5.0
"""Seconds that an ending service waits for what looks after it: a database may be down."""


class ServiceContainer:
    """Service container of the API process: creates settings, repositories, queue and background threads once.

    The queue engine (DBOS) takes seconds to load, so a thread opens it while the service already answers. Jobs that are
    submitted meanwhile wait in the ledger.
    """

    def __init__(self, settings: Settings, clock: Clock = utc_now) -> None:
        self.settings, self.clock, self.ages = settings, clock, TrustedClock(clock)
        self.data = DataDirectory(settings.data)
        self.disk = DiskReserve(self.data.root, settings.disk_reserve_bytes)
        self.database = Database(metadata_url(settings))
        self.arrays = arrays_of(settings, self.database, clock, STORE_PATIENCE)
        self.masks = MaskRepository(self.database, clock)
        self.plans = PlanRepository(self.database, clock)
        self.scans = ScanRepository(self.database, clock)
        self.scanner = ScannerRepository(self.database, clock, settings.scanner_id)
        self.batches = BatchRepository(self.database, clock)
        self.ledger = JobLedger(self.database, clock)
        self.measurements = MeasurementRepository(self.database)
        self.deletion = DeletionService(self.database, clock)
        self.idempotency = IdempotencyStore(self.database, clock)
        self.keys = KeyStore(self.database, clock, fixed=settings.api_key)
        self.sessions = SessionStore(self.database, self.keys, clock)
        secret = shared_secret(shared) if (shared := settings.node_secret) else stored_secret(self.data.stop_secret)
        self.stop_tickets = StopTickets(secret, clock)
        self.log = EventLog(self.database)
        self.emergency = self.status = self.faults = None
        if settings.has_scanner:
            self.emergency = EmergencyStopController(EmergencyLatch(self.data.emergency), self.scanner)
            self.status = StatusBlock(self.data.emergency)
            self.faults = FaultClearingService(ClearFaultRequest(self.data.emergency), self.scanner)
        self.nodes = PeerRegistry(settings, self.scanner)
        self.stop_relay = EmergencyStopRelay(self.nodes, self.scanner)
        self._memory = PeriodicRefresher(self.database, self.sessions.remember, self.nodes.refresh, self._stay)
        self.drawing, self.previewing, self.designing = asyncio.Lock(), asyncio.Lock(), asyncio.Lock()
        """One stored picture, preview and budget at a time."""
        self.process_pool = ProcessPool()
        self.shot_inspections = RowDeltaTracker()
        self.usage: BatchLoader[None, dict[str, int]] = BatchLoader(lambda _: {None: usage(self.database, self.data)})
        self._queue: JobQueue | None = None
        self._opened = threading.Event()
        self._over = threading.Event()
        self._caretaker = threading.Thread(target=self._look_after, daemon=True)
        shared = settings.database_url if settings.role != "service" else None
        self._turn = None if shared is None else AdvisoryLock(shared, "caretaker")
        """Held by the one of several nodes that looks after what is everybody's."""

    def open(self) -> None:
        """Start the background threads: refresh of caches, record of stops, opening of the queue and maintenance."""
        if self.emergency is not None:
            self._note_scanner()
            self.emergency.open()
        if self.is_single_node:
            self._retire_others()
        self.nodes.refresh()
        self._memory.open()
        self._caretaker.start()

    def close(self) -> None:
        """Stop the background threads and close the queue and the database."""
        self._over.set()
        self.process_pool.close()
        self.stop_relay.close()
        self._memory.close()
        if self.emergency is not None:
            self.emergency.close()
        if self._caretaker.is_alive():
            # after this time it would open connections that nobody closes
            self._caretaker.join(CARETAKER_SHUTDOWN_TIMEOUT)
        if self._turn is not None:
            self._turn.release()
        if self._queue is not None:
            self._queue.close()
        self.database.close()

    @property
    def is_single_node(self) -> bool:
        """Whether the service has only this node, without nodes of other scanners on its database."""
        return self.settings.role == "service"

    def _note_scanner(self) -> None:
        own = {"simulated": self.settings.simulated, "follows": self.settings.is_scanner_node}
        self.scanner.ensure(address=self.settings.address, **own)

    def _stay(self) -> None:
        """Register this node's scanner again if it was decommissioned while the node was unreachable."""
        if not self.nodes.is_registered:
            _log.warning("%s was retired, but its node is running: it is registered again", self.scanner.id)
            self._note_scanner()

    def _retire_others(self) -> None:
        """Decommission the scanners of nodes that no longer share this database."""
        for row in self.scanner.rows():
            if row.id != self.scanner.id:
                try:
                    self.scanner.of(row.id).retire("service", "its node is none of this service, which is one alone")
                except InUse as error:
                    _log.warning("%s; DELETE /api/v1/scanners/%s?abandon=true gives them up", error, row.id)

    @property
    def queue(self) -> JobQueue:
        """Client of the job queue, once the queue is open.

        Raises
        ------
        QueueUnavailable
            When the queue does not open within :data:`QUEUE_PATIENCE` seconds.
        """
        if not self._opened.wait(QUEUE_PATIENCE) or self._queue is None:
            raise QueueUnavailable("the job queue is not open yet; the service keeps retrying")
        return self._queue

    @property
    def queue_is_open(self) -> bool:
        """Whether the job queue is open."""
        return self._opened.is_set()

    def local_stop_controller(self, scanner_id: str) -> EmergencyStopController | None:
        """Return the controller of a scanner's emergency stop; ``None`` if the scanner belongs to another node."""
        return self.emergency if self.nodes.is_local(scanner_id) else None

    def require_disk_space(self, need: int, what: str, *, for_scan: bool = False) -> None:
        """Raise :class:`DiskFull` if less than the reserve would stay free on this node's disk.

        Parameters
        ----------
        for_scan
            Whether the work is a scan, which may use the reserve.

        Raises
        ------
        DiskFull
            With the needed and available bytes.
        """
        if self.settings.role != "service" and not (for_scan and self.settings.has_scanner):
            return  # who does the work has a disk of its own
        (replace(self.disk, reserve=0) if for_scan else self.disk).require(need, what)

    def submit(self, session: Session, request: JobRequest) -> JobRow:
        """Insert a job and queue it in the present transaction; before the queue is open, the job waits in the ledger.

        The caller has locked the references of the request.

        Raises
        ------
        InvalidInput
            When no worker satisfies the job's requirements.
        """
        if not self.settings.await_workers:
            own = dedicated_scanner(session, request.kind, request.payload.get("scan_id"))
            require_satisfiable(session, self.clock(), own, request.requires)
        return self.queue.add(session, request) if self.queue_is_open else self.ledger.add(session, request)

    def forecast(self, job: JobStatus) -> QueueEstimate | None:
        """Return a job's queue position and expected end; ``None`` once it has ended."""
        if job.is_over:
            return None
        with self.database.read() as session:
            return forecast(session, job.id, self.settings.workers, self.clock())

    def cancel(self, job_id: str, who: str, reason: str | None) -> JobStatus:
        """Cancel a queued or running job and return its status; raises as :meth:`JobQueue.cancel`."""
        if is_terminal(self.ledger.get(job_id).state) and not self.queue_is_open:
            self.ledger.request_cancellation(job_id, who, reason)
            return self.ledger.status(job_id)
        return self.queue.cancel(job_id, who, reason)

    def _open_queue(self) -> None:
        """Open the queue, with retries; until then readiness reports it as closed."""
        from steradian.jobs.queue.queue_client import JobQueue

        while not self._over.is_set():
            try:
                self._queue = JobQueue(self.settings)
                self._opened.set()
                return
            except QueueUnavailable:
                _log.exception("trying again in %g s", REOPEN_EVERY)
            self._over.wait(REOPEN_EVERY)

    def _look_after(self) -> None:
        self._open_queue()
        gc.collect()
        gc.freeze()  # what was loaded stays; to look through it for garbage stops everybody for a tenth of a second
        tidied = float("-inf")
        while not self._over.is_set():
            try:
                self.process_pool.reap_idle()
                if is_mine := self._turn is None or self._turn.ensure_held() is LockState.HELD:
                    self.queue.reconcile()
                if time.monotonic() - tidied > TIDY_EVERY:
                    tidied = time.monotonic()
                    apply_retention(self, shared=is_mine)
            except Exception:
                if not self._over.is_set():
                    _log.exception("queue maintenance failed; retrying")
            self._over.wait(RECONCILE_EVERY)

    def remove_files(self) -> None:
        """Remove the files of deleted resources; files that cannot be removed yet are retried later."""
        remove_files(self.database, self.data, self.arrays, self.queue.forget if self.queue_is_open else None)
