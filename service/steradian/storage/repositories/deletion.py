"""Deletion of resources and their dependents in one transaction; files are removed afterwards.

A deletion's transaction takes the rows away and notes whose files are to go (table ``removals``); files go afterwards
and the notes last. Whatever ends the process between two of these steps, the notes that are left say what is still to
do: :func:`remove_files` may be repeated at any time.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

from sqlalchemy import delete, or_, select
from sqlalchemy.orm import Session

from steradian.core.exceptions import Conflict, NotFound
from steradian.storage.blobs.interface import BlobStore, result_name, scan_name, upload_name
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.db.tables import BatchRow, JobRow, RemovalRow, ScanRow
from steradian.storage.db.timestamps_and_ids import Clock, utc_now
from steradian.storage.repositories.event_log import append_event
from steradian.storage.repositories.references import DELETION_ORDER, Resource, jobs, lock_dependents
from steradian.storage.state_machines import SETTLED_SCAN_STATES, DesiredScanState, ScanState, is_terminal

_log = logging.getLogger(__name__)
MAX_LISTED: Final = frozenset({"scan", "batch", "reconstruction", "job"})
"""Kinds whose changes are events."""


class HasDependents(Conflict):
    """Error: the resource to delete has dependents."""

    code = "has-dependents"

    def __init__(self, what: Resource, dependents: Sequence[Resource]) -> None:
        self.dependents = dependents
        super().__init__(f"{what.kind} {what.id} has {len(dependents)} dependent resources; delete them too, or first")


class InUse(Conflict):
    """Error: the resource is needed by queued or running work."""

    code = "in-use"


class DeletionService:
    """Service that deletes rows of resources and records the files to remove."""

    def __init__(self, database: Database, clock: Clock = utc_now) -> None:
        self.database, self.clock = database, clock

    def delete(
        self, kind: str, identifier: str, who: str, *, dependents: bool, check: Callable[[Iterable[str]], object]
    ) -> None:
        """Delete a resource and, with ``dependents``, all resources that depend on it.

        Parameters
        ----------
        check
            Called with the kinds of all that would go; raises where ``who`` may not delete them.

        Raises
        ------
        NotFound
            When there is no such thing.
        HasDependents
            When something depends on it that is not to go too.
        InUse
            When something of it waits or runs.
        """
        with self.database.write() as session:
            first = _find(session, kind, identifier)
            found = lock_dependents(session, first)
            check({one.kind for one in found})
            if busy := _busy(session, found):
                raise InUse(f"{kind} {identifier} cannot be deleted while something waits or runs: {', '.join(busy)}")
            if len(found) > 1 and not dependents:
                raise HasDependents(first, found[1:])
            self.delete_rows(session, found, who, "requested")

    def delete_rows(self, session: Session, found: Sequence[Resource], who: str, why: str) -> None:
        """Delete the rows of resources in the caller's transaction, append events and record the files to remove."""
        now, by_kind = self.clock(), {kind: [one.id for one in found if one.kind == kind] for kind in DELETION_ORDER}
        for one in found:
            if one.kind in MAX_LISTED:
                about = _event_of(session, one) | {"state": "deleted", "who": who, "why": why}
                append_event(session, now, one.kind, one.id, about)
            session.add(RemovalRow(kind=one.kind, resource_id=one.id))
        session.flush()
        for kind, table in reversed(DELETION_ORDER.items()):
            session.execute(delete(table).where(table.id.in_(by_kind[kind])))


def waiting_import(database: Database, upload_id: str) -> str | None:
    """Return the unfinished import job that needs an upload; ``None`` if there is none."""
    named = [JobRow.payload[name].as_string() == upload_id for name in ("upload_id", "companion_id")]
    with database.read() as session:
        return session.scalars(select(JobRow.id).where(or_(*named), JobRow.ended.is_(None))).first()


def delete_upload(database: Database, arrays: BlobStore, upload_id: str) -> None:
    """Delete a file that was uploaded over HTTP.

    Raises
    ------
    NotFound
        When there is none.
    InUse
        When an import has still to read it.
    """
    name = upload_name(upload_id)
    if not (upload_id.isascii() and upload_id.isalnum() and arrays.stat(name)):
        raise NotFound("upload", upload_id)
    if (job := waiting_import(database, upload_id)) is not None:
        raise InUse(f"upload {upload_id} cannot be deleted while job {job} waits or runs")
    arrays.delete(name)


def remove_files(
    database: Database, data: DataDirectory, arrays: BlobStore, forget_jobs: Callable[[Sequence[str]], object] | None
) -> None:
    """Remove the files of deleted resources, then their removal records; failed removals are retried later.

    Parameters
    ----------
    forget_jobs
        Lets the queue forget jobs; ``None`` while there is no queue.
    """
    with database.read() as session:
        notes = list(session.scalars(select(RemovalRow).order_by(RemovalRow.sequence)))
    for note in notes:
        try:
            if not _remove(data, arrays, note, forget_jobs):
                continue
        except OSError as error:
            _log.warning("files of %s %s cannot be removed yet: %s", note.kind, note.resource_id, error)
            continue
        # Its number may be another note's by now: SQLite gives that of the last row again when the row is gone.
        same = RemovalRow.sequence == note.sequence, RemovalRow.resource_id == note.resource_id
        with database.write() as session:
            session.execute(delete(RemovalRow).where(*same))


def _remove(
    data: DataDirectory, arrays: BlobStore, note: RemovalRow, forget_jobs: Callable[[Sequence[str]], object] | None
) -> bool:
    match note.kind:
        case "mask":
            data.picture(note.resource_id).unlink(missing_ok=True)
        case "scan":
            arrays.delete(scan_name(note.resource_id))
            for image in data.references.glob(f"{note.resource_id}-*"):
                image.unlink(missing_ok=True)
        case "job" | "reconstruction":
            if data.job(note.resource_id).is_running:  # its process is still dying
                return False
            arrays.delete(result_name(note.resource_id))
            if forget_jobs is None:
                return False
            forget_jobs([note.resource_id])
    return True


def _find(session: Session, kind: str, identifier: str) -> Resource:
    table = DELETION_ORDER[kind]
    found = session.scalar(select(table.id).where(table.id == identifier))
    if found is not None and table is JobRow:
        (made,) = jobs(session, JobRow.id == identifier)
        if kind == made.kind or kind == "job":
            return made
    if found is None or table is JobRow:
        raise NotFound(kind, identifier)
    return Resource(kind, identifier)


def _busy(session: Session, found: Sequence[Resource]) -> list[str]:
    """Return the identifiers of unfinished scans and jobs among the resources, and lock their rows."""
    scans = select(ScanRow).where(ScanRow.id.in_([one.id for one in found if one.kind == "scan"])).with_for_update()
    busy = select(JobRow).where(JobRow.id.in_([one.id for one in found if DELETION_ORDER[one.kind] is JobRow]))
    going = [row.id for row in session.scalars(scans) if not _is_settled(row)]
    return going + [row.id for row in session.scalars(busy.with_for_update()) if not is_terminal(row.state)]


def _is_settled(scan: ScanRow) -> bool:
    resumes = scan.state is ScanState.INTERRUPTED and scan.desired_state is DesiredScanState.RUNNING
    return scan.state in SETTLED_SCAN_STATES and not resumes


def _event_of(session: Session, one: Resource) -> dict[str, Any]:
    """Return the scan and batch identifiers by which event streams filter a resource's events."""
    if one.kind == "scan":
        return {}
    if one.kind == "batch":
        return {"scan_id": session.scalar(select(BatchRow.scan_id).where(BatchRow.id == one.id))}
    row = session.scalars(select(JobRow).where(JobRow.id == one.id)).one()
    return {"scan_id": row.scan_id, "batch_id": row.batch_id}
