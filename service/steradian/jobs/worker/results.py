"""Upload of job results and logs to the object store, committed with the job's success."""

from __future__ import annotations

import logging
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError

from steradian.core.atomic_files import DRAFT_SUFFIX
from steradian.core.exceptions import NotFound, StaleFence, StoreUnavailable
from steradian.core.settings import Settings
from steradian.jobs.job import Outcome, Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.storage.blobs.interface import BlobStore, StagedBlob, result_name
from steradian.storage.blobs.object_store import arrays_of
from steradian.storage.data_dir.job_directory import LOG, JobDirectory
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.db.tables import JobRow, ObjectRow
from steradian.storage.state_machines import ReconstructionState

STAGED_KEY: Final = "in the store"
"""Under which name a report says what of it is kept; no report of a job has it."""
_log = logging.getLogger(__name__)


def upload_results(arrays: BlobStore, folder: JobDirectory) -> dict[str, Any]:
    """Upload all result files of a job to the object store and return the uncommitted entries for its report.

    The volume first, which takes longest: until the success is noted, what has gone can be had from nowhere.
    """
    largest = sorted(folder.results(), key=lambda path: path.stat().st_size, reverse=True)
    return {STAGED_KEY: [arrays.put(result_name(folder.root.name, path.name), path).as_json() for path in largest]}


class ResultUploader:
    """Uploader of job results and logs to the object store; does nothing without a store."""

    def __init__(self, settings: Settings, database: Database) -> None:
        self._has_store = settings.store is not None
        self._arrays, self._database = arrays_of(settings, database), database

    def with_commit(self, outcome: Outcome) -> Outcome:
        """Return the outcome with a callback that commits the uploaded results together with the success."""
        if not isinstance(outcome, Succeeded) or not self._has_store or STAGED_KEY not in outcome.result:
            return outcome
        stored = [StagedBlob.of_json(each) for each in outcome.result[STAGED_KEY]]
        report = {name: value for name, value in outcome.result.items() if name != STAGED_KEY}
        return Succeeded(report, lambda session: self._arrays.commit(session, *stored))

    def upload_leftovers(self, ledger: JobLedger, data: DataDirectory) -> None:
        """Upload the logs of ended jobs from folders left on this host, and remove the folders.

        Results of earlier times, before there was a store, stay: they are nowhere else.
        """
        folders = {path.name: data.job(path.name) for path in data.job_folders()} if self._has_store else {}
        for job_id, job in ledger.statuses(list(folders)).items():
            with suppress(NotFound, StaleFence, OSError):  # deleted meanwhile, or of a start that no database knows
                needed = job.state is ReconstructionState.SUCCEEDED and self._has_more(folders[job_id])
                if job.is_over and not needed and not folders[job_id].is_running:
                    row, start = ledger.get(job_id), folders[job_id].latest_attempt
                    folders[job_id].check_fence(row.fence)
                    self.upload_log_and_remove(
                        job_id, start, folders[job_id]
                    )  # the newest start may have been on another host

    def _has_more(self, folder: JobDirectory) -> bool:
        """Return whether a job's folder has result files that are not in the store."""
        return any(not self._is_kept(result_name(folder.root.name, path.name)) for path in folder.results())

    def _is_kept(self, name: str) -> bool:
        with self._database.read() as session:
            return session.get(ObjectRow, name) is not None

    def upload_log_and_remove(self, job_id: str, start: int, folder: JobDirectory) -> None:
        """Upload the log of an attempt, unless the job was deleted, and remove the job's local folder.

        Raises
        ------
        StaleFence
            When a later start has begun there.
        """
        if not self._has_store or not folder.log.is_file():
            return
        folder.check_fence(start)
        try:
            copy = Path(shutil.copy(folder.log, folder.root / f"{LOG}{DRAFT_SUFFIX}"))  # who wrote it may have it open
            stored = self._arrays.put(result_name(job_id, f"{LOG}-{start:04}.txt"), copy)
            with self._database.write() as session:
                if session.scalar(select(JobRow.id).where(JobRow.id == job_id).with_for_update()) is not None:
                    self._arrays.commit(session, stored)
            shutil.rmtree(folder.root)
        except (StoreUnavailable, SQLAlchemyError, OSError) as error:
            _log.warning("the log of job %s stays in %s: %s", job_id, folder.root, error)
