"""What the handlers work with: the settings, the repositories and the queue."""

from __future__ import annotations

import logging
import threading
from concurrent.futures import Future
from typing import TYPE_CHECKING

from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.worker import reconstruction_job
from steradian.settings import Settings
from steradian.storage.database import Database
from steradian.storage.jobs import JobStatus, QueueUnavailable
from steradian.storage.masks import MaskRepository
from steradian.storage.paths import DataDirectory
from steradian.storage.plans import PlanRepository
from steradian.storage.reconstructions import ReconstructionRepository
from steradian.storage.repository import Clock, utc_now
from steradian.storage.scans import ScanRepository
from steradian.storage.states import ReconstructionState
from steradian.storage.tables import ReconstructionRow

if TYPE_CHECKING:
    from steradian.storage.queue import JobQueue

_log = logging.getLogger(__name__)
QUEUE_PATIENCE = 30.0


class Services:
    """Everything behind the API; made once a process.

    The queue's engine takes seconds to load, so it is opened in a thread while the service already answers.
    """

    def __init__(self, settings: Settings, clock: Clock = utc_now) -> None:
        self.settings = settings
        self.data = DataDirectory(settings.data)
        self.database = Database(self.data.metadata_url)
        self.masks = MaskRepository(self.database, clock)
        self.plans = PlanRepository(self.database, clock)
        self.scans = ScanRepository(self.database, clock)
        self.reconstructions = ReconstructionRepository(self.database, clock)
        self._queue: Future[JobQueue] = Future()

    def open(self) -> None:
        """Begin to open the queue and to hand it what a crash kept from it."""
        threading.Thread(target=self._open_queue, daemon=True).start()

    def close(self) -> None:
        """Close the connections."""
        if self._queue.done() and self._queue.exception() is None:
            self._queue.result().close()
        self.database.close()

    @property
    def queue(self) -> JobQueue:
        """The job queue.

        Raises
        ------
        QueueUnavailable
            When it does not open.
        """
        try:
            return self._queue.result(QUEUE_PATIENCE)
        except TimeoutError:
            raise QueueUnavailable("the job queue is still being opened") from None

    def require_queue(self) -> None:
        """Fail before anything is written when the queue does not open, with :class:`QueueUnavailable`."""
        self.queue  # noqa: B018 - asked for its exception

    @property
    def queue_is_open(self) -> bool:
        """Whether jobs can be taken at once."""
        return self._queue.done() and self._queue.exception() is None

    def submit(self, row: ReconstructionRow) -> None:
        """Hand a reconstruction to the queue; doing it twice does it once."""
        parameters = ReconstructionParameters.create(**row.parameters)
        scan = self.data.scan_file(row.scan_id)
        self.queue.submit(reconstruction_job(row.id, self.settings, scan, parameters))
        self.reconstructions.mark_submitted(row.id)

    def status(self, row: ReconstructionRow) -> JobStatus:
        """Tell how a reconstruction stands."""
        if not row.submitted:
            return JobStatus(row.id, ReconstructionState.QUEUED)
        return self.queue.status(row.id)

    def _open_queue(self) -> None:
        try:
            from steradian.storage.queue import JobQueue

            self._queue.set_result(JobQueue(self.settings))
            for row in self.reconstructions.unsubmitted():
                self.submit(row)
                if row.cancel_wanted:
                    self.queue.cancel(row.id)
        except Exception as error:
            _log.exception("the job queue cannot be opened")
            if not self._queue.done():
                self._queue.set_exception(QueueUnavailable(f"the job queue cannot be opened: {error}"))
