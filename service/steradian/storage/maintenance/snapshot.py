"""Consistent snapshot of the database as a SQLite file, and its restore."""

from __future__ import annotations

import secrets
import sqlite3
import uuid
from contextlib import closing
from pathlib import Path
from typing import Final

from sqlalchemy import Connection, delete, func, insert, select, text

from steradian.core.exceptions import Conflict
from steradian.storage.data_dir.sqlite_urls import file_uri, sqlite_url
from steradian.storage.db.database import Database
from steradian.storage.db.tables import Base, FactRow, SessionRow
from steradian.storage.maintenance.folder_binding import FACT_KEY

BATCH_ROWS: Final = 1000
"""Rows that are held in memory."""


def take_snapshot(database: Database, path: Path) -> None:
    """Copy a consistent snapshot of a database into a new SQLite file, without blocking writers.

    A SQLite file is copied whole, with the queue. Of PostgreSQL only the metadata are copied, table by table in one
    repeatable-read transaction; the queue is rebuilt from them after a restore.
    """
    path.unlink(missing_ok=True)
    if database.is_file:
        _copy_file(Path(database.name), path)
    else:
        target = Database(sqlite_url(path, "destination"))
        try:
            target.migrate()
            with database.engine.connect().execution_options(isolation_level="REPEATABLE READ") as source:
                with target.engine.execution_options(immediate=True).begin() as connection:
                    _copy_rows(source, connection)
        finally:
            target.close()
    _make_one_file(path)


def require_empty(database: Database) -> None:
    """Raise :class:`Conflict` if a database has rows."""
    with database.read() as session:
        for table in Base.metadata.sorted_tables:
            if table is not FactRow.__table__ and session.scalar(select(func.count()).select_from(table)):
                raise Conflict(f"the database {database.name} holds {table.name} already; name an empty one")


def restore_snapshot(path: Path, database: Database) -> None:
    """Copy all rows of a snapshot into an empty PostgreSQL database in one transaction."""
    source = Database(sqlite_url(path, "backup"))
    try:
        with source.engine.connect() as rows, database.engine.begin() as target:
            _copy_rows(rows, target)
            for table in Base.metadata.sorted_tables:
                if "sequence" in table.columns:  # the next row of a service comes after these
                    serial = f"pg_get_serial_sequence('{table.name}', 'sequence')"
                    newest = f"(SELECT max(sequence) FROM {table.name})"  # noqa: S608 - our own names
                    target.execute(text(f"SELECT setval({serial}, greatest(1, {newest}))"))
    finally:
        source.close()


def assign_new_identity(database: Database) -> str:
    """Give a copied database a new identifier and event-log epoch, and delete its sessions; return the identifier.

    Workers of the original are rejected by the identifier, clients of the original's event log by the epoch. Sessions
    of the original are not valid in the copy.
    """
    name = uuid.uuid4().hex
    with database.write() as session:
        session.execute(delete(SessionRow))
        database.set_fact(session, FACT_KEY, name)
        database.set_fact(session, "epoch", secrets.token_hex(4))
    return name


def _copy_file(source: Path, target: Path) -> None:
    """Copy a SQLite database with SQLite's backup API in a single step, without blocking writers."""
    with (
        closing(sqlite3.connect(file_uri(source), uri=True)) as rows,
        closing(sqlite3.connect(target)) as copy,
    ):
        rows.backup(copy)


def _copy_rows(source: Connection, target: Connection) -> None:
    target.execute(delete(FactRow))  # what the migrations noted of the empty database
    for table in Base.metadata.sorted_tables:
        rows = source.execution_options(stream_results=True).execute(select(table).order_by(*table.primary_key))
        for piece in rows.mappings().partitions(BATCH_ROWS):
            target.execute(insert(table), [dict(row) for row in piece])


def _make_one_file(path: Path) -> None:
    """Merge SQLite's write-ahead log into the database file."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode=DELETE")
