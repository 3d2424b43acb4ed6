"""Integrity check of database and data folder before the service starts."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sqlalchemy import Row, Select, select
from sqlalchemy.exc import DatabaseError

from steradian.core.exceptions import DamagedFile
from steradian.core.settings import Settings
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.data_dir.sqlite_urls import file_uri
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.db.tables import JobRow, RemovalRow, ScanRow

MAGIC = b"SQLite format 3\0"
MAX_LISTED = 5
"""Of so many names at most a sentence is made."""


def sqlite_fault(path: Path) -> str | None:
    """Return a description of the damage of a closed SQLite file; ``None`` if it is intact."""
    if not path.exists():
        return "is missing"
    if not path.stat().st_size:
        return "is empty (0 bytes)"
    try:
        connection = sqlite3.connect(file_uri(path), uri=True)
        try:
            found = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
        finally:
            connection.close()
    except sqlite3.DatabaseError as error:
        return "is not an SQLite database" if "not a database" in str(error) else f"is damaged ({error})"
    return None if found == "ok" else f"is damaged ({' '.join(found.split())})"


def is_database(path: Path) -> bool:
    """Return whether a file begins with SQLite's magic bytes."""
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except FileNotFoundError:
        return False


def is_missing(path: Path) -> bool:
    """Return whether a database file does not exist or is empty."""
    return not path.exists() or not path.stat().st_size


def rows_of(settings: Settings, query: Select[Any]) -> Sequence[Row[Any]]:
    """Run a query on a database of any schema version; a missing table or damaged file yields an empty list."""
    if settings.database_url is None and sqlite_fault(DataDirectory(settings.data).metadata_file) is not None:
        return []
    database = Database(metadata_url(settings))
    try:
        with database.read() as session:
            return session.execute(query).all()
    except DatabaseError as error:
        if "no such table" in str(error.orig) or "does not exist" in str(error.orig):
            return []
        raise
    finally:
        database.close()


def pending_removals(settings: Settings) -> set[str]:
    """Return the identifiers of deleted resources with files that are not yet removed."""
    return {row.resource_id for row in rows_of(settings, select(RemovalRow.resource_id))}


def check_before_start(settings: Settings) -> list[str]:
    """Check database and data folder for damage, and return scan files without a database row.

    Returns
    -------
    list of str
        Scans whose files lie in the folder while the database, which knows others, does not know them.

    Raises
    ------
    DamagedFile
        When a database is damaged, or knows nothing of what the folder holds.
    """
    data = DataDirectory(settings.data)
    advice = f"`steradian check {settings.data}` lists what can be recovered"
    metadata = None
    if settings.database_url is None:
        metadata = sqlite_fault(data.metadata_file)
        if metadata is not None and not is_missing(data.metadata_file):
            raise DamagedFile(f"the database {data.metadata_file} {metadata}; {advice}")
    files = {path.stem for path in data.scan_files()}
    known = {row.id for row in rows_of(settings, select(ScanRow.id))} | pending_removals(settings)
    # An import that was cut off has left its scan, named after it, before the row.
    imports = rows_of(settings, select(JobRow.id).where(JobRow.kind == "import"))
    jobs = [path.name for path in data.job_folders()] if metadata else []
    if (files and not files & (known | {f"s{row.id[1:]}" for row in imports})) or jobs:
        what = f"{len(files)} scan(s)" if files else f"results of {len(jobs)} job(s)"
        where = data.metadata_file if settings.database_url is None else "STERADIAN_DATABASE_URL"
        wrong = f"{metadata}, but there are" if metadata else "knows none of the"
        raise DamagedFile(f"the database {where} {wrong} {what} in {data.root}; {advice}")
    return sorted(files - known)
