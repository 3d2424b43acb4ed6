"""Consistency check of data folder and database (fsck), with repair of damaged databases and unknown scans."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import select

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.core.settings import Settings
from steradian.reconstructions.scan_plan_reader import read_stored_plan
from steradian.storage.blobs.interface import BlobStore, FolderBlobStore, result_name, scan_name
from steradian.storage.data_dir.job_directory import SERIES, VOLUME
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.db.tables import JobRow, ScanRow
from steradian.storage.maintenance.startup_check import is_missing, pending_removals, rows_of, sqlite_fault
from steradian.storage.repositories.imports import register_import
from steradian.storage.state_machines import ReconstructionState, is_terminal

MAX_ID_LENGTH = 40


@dataclass(frozen=True)
class Inconsistency:
    """Finding of the consistency check: kind, subject and description.

    Attributes
    ----------
    kind
        ``damaged-database``, ``unknown-scan``, ``unreadable-scan``, ``missing-scan``, ``unknown-result``,
        ``missing-result`` or ``unfinished-result``.
    subject
        Identifier of the scan or job, or name of the file.
    text
        What is wrong and what can be done.
    """

    kind: str
    subject: str
    text: str


def check_consistency(settings: Settings) -> list[Inconsistency]:
    """Compare data folder and database without changes; no other process may use them meanwhile."""
    arrays: BlobStore = FolderBlobStore(data := DataDirectory(settings.data))
    found = [*_databases(settings, data), *_scans(settings, data, arrays), *_results(settings, data, arrays)]
    going = pending_removals(settings)
    return [finding for finding in found if finding.subject not in going]


def repair(settings: Settings) -> Iterator[str]:
    """Rename damaged databases, create new ones and register scan files without a database row.

    Yields
    ------
    str
        What was done, one sentence at a time.
    """
    data = DataDirectory(settings.data)
    found = check_consistency(settings)
    for finding in found:
        if finding.kind == "damaged-database":
            yield from _set_aside(data.root / finding.subject)
    database = Database(metadata_url(settings))
    try:
        database.migrate()
        for finding in found:
            if finding.kind == "unknown-scan":
                said = read_stored_plan(data.scan_file(finding.subject))
                about: dict[str, Any] = {"simulated": said.simulated, "summary": said.summary, "labels": {}}
                register_import(database, said.plan, finding.subject, who="steradian check", **about)
                yield f"scan {finding.subject} is registered: {_alines(said.summary)}"
    finally:
        database.close()


def _databases(settings: Settings, data: DataDirectory) -> Iterator[Inconsistency]:
    if settings.database_url is not None:
        return
    holds = bool(data.scan_files() or data.job_folders())
    fault = sqlite_fault(data.metadata_file)
    if fault is not None and (holds or not is_missing(data.metadata_file)):
        yield Inconsistency("damaged-database", data.metadata_file.name, f"{fault}; --repair makes a new one")


def _scans(settings: Settings, data: DataDirectory, arrays: BlobStore) -> Iterator[Inconsistency]:
    rows = {row.id: row for row in rows_of(settings, select(ScanRow.id, ScanRow.summary))}
    for path in data.scan_files():
        if path.stem not in rows:
            yield _unknown_scan(path)
    for identifier, row in rows.items():
        if (row.summary or {}).get("stored") and arrays.stat(scan_name(identifier)) is None:
            yield Inconsistency("missing-scan", identifier, f"{_alines(row.summary)} were stored; its file is gone")


def _unknown_scan(path: Path) -> Inconsistency:
    try:
        said = read_stored_plan(path)
    except (DamagedFile, InvalidInput) as error:
        return Inconsistency("unreadable-scan", path.stem, f"no row in the database, and {error}")
    if not path.stem.isascii() or not path.stem.isalnum() or len(path.stem) > MAX_ID_LENGTH:
        return Inconsistency(
            "unreadable-scan", path.stem, "no row in the database, and its name is not an identifier: import it"
        )
    return Inconsistency(
        "unknown-scan", path.stem, f"no row in the database; {_alines(said.summary)}; --repair registers it"
    )


def _results(settings: Settings, data: DataDirectory, arrays: BlobStore) -> Iterator[Inconsistency]:
    query = select(JobRow.id, JobRow.resource, JobRow.state, JobRow.result)
    rows = {row.id: row for row in rows_of(settings, query)}
    for path in data.job_folders():
        job = data.job(path.name)
        if path.name not in rows:
            found = [name for name in (VOLUME, SERIES) if (path / name).is_file()]
            what = f"{found[0]}, which `steradian.open` reads" if found else "files"
            yield Inconsistency("unknown-result", path.name, f"no row in the database; jobs/{path.name} holds {what}")
        elif not is_terminal(rows[path.name].state) and job.report.is_file():
            state = rows[path.name].state
            text = f"its results are complete, the database state is {state}: it will run again"
            yield Inconsistency("unfinished-result", path.name, text)
    for identifier, row in rows.items():
        if row.state is not ReconstructionState.SUCCEEDED:
            continue
        result = row.result or {}
        volume = SERIES if result.get("frames") else VOLUME
        wanted = [volume] if row.resource == "reconstruction" else result.get("files", [])
        if gone := [name for name in wanted if arrays.stat(result_name(identifier, name)) is None]:
            yield Inconsistency("missing-result", identifier, f"it has succeeded; {', '.join(gone)} is gone")


def _set_aside(path: Path) -> Iterator[str]:
    """Rename a damaged database file with its log, unless it is empty."""
    if is_missing(path):
        return
    number = 1
    while (kept := path.with_name(f"{path.name}.damaged-{number}")).exists():
        number += 1
    for ending in ("", "-wal", "-shm"):
        if (part := path.with_name(path.name + ending)).exists():
            part.rename(kept.with_name(kept.name + ending))
    yield f"{path.name} is set aside as {kept.name}"


def _alines(summary: dict[str, int]) -> str:
    return f"{summary.get('stored', 0):,} of {summary.get('points', 0):,} A-lines"
