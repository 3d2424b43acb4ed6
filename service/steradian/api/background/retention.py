"""Periodic clean-up: expired events, idempotency keys, uploads, temporary files, orphaned objects and old jobs."""

from __future__ import annotations

import logging
import os
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Protocol

from sqlalchemy import select

from steradian.core.atomic_files import remove, remove_drafts, remove_older
from steradian.core.settings import Settings
from steradian.storage.blobs.interface import BlobStore, upload_name
from steradian.storage.blobs.object_store import S3BlobStore
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.db.tables import JobRow, ScanRow
from steradian.storage.db.timestamps_and_ids import Clock
from steradian.storage.maintenance.clock_trust import EARLIEST, TrustedClock, redate, tell_redated
from steradian.storage.repositories.deletion import DeletionService, waiting_import
from steradian.storage.repositories.event_log import EventLog
from steradian.storage.repositories.idempotency import IdempotencyStore
from steradian.storage.repositories.imports import importing_job_id
from steradian.storage.repositories.references import Resource, referenced_jobs

UPLOADS_KEPT = timedelta(days=1)
_log = logging.getLogger(__name__)


class RetentionContext(Protocol):
    """Protocol of the settings, repositories and stores that retention uses."""

    settings: Settings
    clock: Clock
    ages: TrustedClock
    data: DataDirectory
    database: Database
    arrays: BlobStore
    log: EventLog
    idempotency: IdempotencyStore
    deletion: DeletionService

    def remove_files(self) -> None:
        """Remove the files of deleted resources; files that cannot be removed yet are retried later."""


def apply_retention(context: RetentionContext, *, shared: bool = True) -> None:
    """Apply retention: delete expired events, idempotency keys, uploads, cached images and, if configured, jobs.

    Parameters
    ----------
    shared
        Whether to clean up also the database and store that all nodes share; otherwise only this node's folder.
    """
    _sweep_drafts(context)
    is_sure = context.ages.can_be_trusted(context.database)
    if is_sure:
        oldest = (context.clock() - UPLOADS_KEPT).timestamp()
        remove_older(context.data.references, oldest)
        remove_older(context.data.uploads, oldest, "*.part")  # of a process that was killed
    if is_sure and shared:
        _forget_uploads(context, oldest)
        context.log.prune(context.clock() - timedelta(days=context.settings.event_days))
        context.idempotency.prune()
        if context.settings.retention_days is not None:
            _delete_jobs_before(context, timedelta(days=context.settings.retention_days))
    if not shared:
        return
    context.remove_files()
    if is_sure and isinstance(context.arrays, S3BlobStore) and (count := context.arrays.collect_orphans()):
        _log.info("%d objects that belonged to nothing are deleted from the store", count)


def _forget_uploads(context: RetentionContext, oldest: float) -> None:
    """Delete uploads received before ``oldest`` (s since the epoch), except those that a queued import needs."""
    for name in context.arrays.list_names(upload_name("")):
        found, upload = context.arrays.stat(name), name.rpartition("/")[2]
        if not found or found.modified >= oldest or waiting_import(context.database, upload) is not None:
            continue
        came = datetime.fromtimestamp(found.modified, UTC)
        if came < EARLIEST:
            with suppress(FileNotFoundError):
                os.utime(context.data.upload(upload))
                tell_redated(f"upload {upload}", came)
            continue
        context.arrays.delete(name)
        _log.info("upload %s is deleted: it was uploaded at %s, and uploads are kept for one day", upload, came)


def _sweep_drafts(context: RetentionContext) -> None:
    """Delete the temporary files of killed jobs; jobs that will be retried clean their folders at the next attempt."""
    data, drafts = context.data, context.data.scan_drafts()
    with context.database.read() as session:
        over = set(session.scalars(select(JobRow.id).where(JobRow.ended.is_not(None))))
        going = set(session.scalars(select(JobRow.id).where(JobRow.ended.is_(None))))
        going |= set(session.scalars(select(ScanRow.id).where(ScanRow.ended.is_(None))))
    for folder in data.job_folders():
        if folder.name in over and not data.job(folder.name).is_running:
            remove_drafts(folder)
    for scan, draft in drafts:
        job = importing_job_id(scan)
        if not going & {scan, job} and not data.job(job).is_running:
            remove(draft)


def _delete_jobs_before(context: RetentionContext, age: timedelta) -> None:
    when = context.clock() - age
    query = select(JobRow.id, JobRow.resource, JobRow.ended).where(JobRow.ended.is_not(None), JobRow.ended < when)
    with context.database.write() as session:
        redate(session, when, context.clock())
        # Nobody begins to need one any more. In the order of deletions, or two wait for each other: first what
        # stands behind /reconstructions, then what may depend on it, each by name.
        ordered = query.order_by(JobRow.resource != "reconstruction", JobRow.id)
        rows = session.execute(ordered.with_for_update()).all()
        kept = referenced_jobs(session)
        old = [row for row in rows if row.id not in kept]
        gone = [Resource(row.resource, row.id) for row in old]
        context.deletion.delete_rows(session, gone, "service", "older than retention_days")
    for row in old:
        about = (row.resource, row.id, row.ended, age.total_seconds() / 86_400)
        _log.info("%s %s is deleted: it ended at %s, more than %g days ago (retention_days)", *about)
