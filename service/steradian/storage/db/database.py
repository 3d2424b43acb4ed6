"""Metadata database: engine, sessions and migrations."""

from __future__ import annotations

import logging
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event, inspect, select, text
from sqlalchemy.exc import DatabaseError
from sqlalchemy.orm import Session, sessionmaker

from steradian.core.exceptions import DamagedFile
from steradian.core.settings import Settings
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.data_dir.sqlite_urls import file_uri
from steradian.storage.db.advisory_locks import TIMEOUTS
from steradian.storage.db.sqlite_subseconds import add_subseconds
from steradian.storage.db.tables import FactRow

MIGRATIONS = Path(__file__).parent / "migrations"
BUSY_TIMEOUT_MS = 15_000
MIGRATION_LOCK = 0x57E2AD1B
"""Number of the PostgreSQL advisory lock under which tables are changed."""


class Database:
    """Metadata database: SQLAlchemy engine, read and write sessions, and migrations.

    ``url`` is an SQLAlchemy URL; with ``read_only`` a SQLite file is opened without writing. Sessions for reading and
    writing differ because SQLite has one writer: a write session acquires the lock at its start instead of failing
    when it upgrades a read lock.
    """

    def __init__(self, url: str, *, read_only: bool = False) -> None:
        self.engine = _reader(url) if read_only else _engine(url)
        self._readers = sessionmaker(self.engine, expire_on_commit=False)
        self._writers = sessionmaker(self.engine.execution_options(immediate=True), expire_on_commit=False)

    @contextmanager
    def read(self) -> Iterator[Session]:
        """Yield a session for read queries."""
        with self._readers() as session:
            yield session

    @contextmanager
    def write(self) -> Iterator[Session]:
        """Yield a session with changes that are committed at the end of the block, or rolled back on an exception."""
        with self._writers.begin() as session:
            yield session

    @property
    def name(self) -> str:
        """Path of the SQLite file, or URL of the server without its password."""
        url = self.engine.url
        return url.database or "" if self.engine.dialect.name == "sqlite" else url.render_as_string()

    def check(self) -> None:
        """Check that the database answers and accepts writes; raises SQLAlchemy's exceptions."""
        with self.write() as session:
            session.execute(text("SELECT 1"))

    def migrate(self) -> None:
        """Migrate the schema to the newest version with Alembic.

        Raises
        ------
        DamagedFile
            When a newer version has created the tables, or the SQLite file is damaged.
        """
        try:
            if self.revision() != known_revisions()[0]:
                self._migrate()
        except DatabaseError as error:
            if self.engine.dialect.name != "sqlite":
                raise
            raise DamagedFile(f"the database {self.name} cannot be used: {error.orig}") from error

    def _migrate(self) -> None:
        logging.getLogger("alembic").setLevel(logging.WARNING)
        from alembic import command
        from alembic.config import Config
        from alembic.util import CommandError

        config = Config()
        config.set_main_option("script_location", str(MIGRATIONS))
        try:
            with self.migrating(), self.engine.execution_options(immediate=True).begin() as connection:
                config.attributes["connection"] = connection
                command.upgrade(config, "head")
        except CommandError as error:
            raise DamagedFile(f"the database {self.name} is of a newer version of Steradian: {error}") from error

    def get_fact(self, session: Session, name: str) -> str | None:
        """Return the value of a key in the table of database-wide facts."""
        return session.scalar(select(FactRow.value).where(FactRow.name == name))

    def set_fact(self, session: Session, name: str, value: str) -> None:
        """Set the value of a key in the table of database-wide facts."""
        session.merge(FactRow(name=name, value=value))

    @property
    def is_file(self) -> bool:
        """Whether the database is a SQLite file."""
        return self.engine.dialect.name == "sqlite"

    def revision(self) -> str | None:
        """Return the Alembic revision of the schema; ``None`` before tables are created."""
        with self.engine.connect() as connection:
            if not inspect(connection).has_table("alembic_version"):
                return None
            revision: str | None = connection.scalar(text("SELECT version_num FROM alembic_version"))
            return revision

    @contextmanager
    def migrating(self) -> Iterator[None]:
        """Hold the migration lock until the block ends, so that no other process migrates (PostgreSQL only)."""
        if self.engine.dialect.name != "postgresql":
            yield
            return
        # Who waits asks again and again: a statement that waits for the lock keeps its snapshot, and an index that is
        # built beside running work, as the queue's engine does, waits for every snapshot to go: a deadlock.
        with self.engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            key = {"key": MIGRATION_LOCK}
            while not connection.scalar(text("SELECT pg_try_advisory_lock(:key)"), key):
                time.sleep(0.2)
            try:
                yield
            finally:
                connection.execute(text("SELECT pg_advisory_unlock(:key)"), {"key": MIGRATION_LOCK})

    def close(self) -> None:
        """Close all connections to the database; one that a thread still uses is closed when it is returned."""
        # a disposed engine's earlier pool would keep what is returned to it, open
        event.listen(self.engine.pool, "checkin", lambda _, record: record.invalidate())
        self.engine.dispose()


def advisory_xact_lock(session: Session, lock: int) -> None:
    """Acquire an advisory lock until the end of the transaction (PostgreSQL; SQLite has a single writer anyway)."""
    if session.get_bind().dialect.name == "postgresql":
        session.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": lock})


def metadata_url(settings: Settings) -> str:
    """Return the URL of the metadata database: the one in the settings, else a file in the data directory."""
    if settings.database_url is None:
        return DataDirectory(settings.data).metadata_url
    return "postgresql+psycopg" + settings.database_url[settings.database_url.index("://") :]


def known_revisions() -> list[str]:
    """Return all Alembic revisions of the schema, newest first; the file of a migration begins with its revision."""
    return sorted((path.name[:4] for path in (MIGRATIONS / "versions").glob("[0-9]*.py")), reverse=True)


def _reader(url: str) -> Engine:
    """Return an SQLAlchemy engine that opens a SQLite file read-only."""
    engine = create_engine(url)

    @event.listens_for(engine, "do_connect")
    def connect(_dialect: Any, _record: Any, _arguments: Any, _parameters: Any) -> sqlite3.Connection:
        path = Path(engine.url.database or "")
        # Beside a file that no process has open there is no log: nothing changes it.
        at_rest = not path.with_name(f"{path.name}-wal").exists()
        return sqlite3.connect(file_uri(path, immutable=at_rest), uri=True, check_same_thread=False)

    return engine


def _engine(url: str) -> Engine:
    if not url.startswith("sqlite"):
        connect = TIMEOUTS | {"application_name": "steradian"}
        return create_engine(url, pool_pre_ping=True, pool_size=10, max_overflow=20, connect_args=connect)
    engine = create_engine(url, connect_args={"check_same_thread": False})

    @event.listens_for(engine, "connect")
    def configure(connection: Any, _record: Any) -> None:
        add_subseconds(connection)
        connection.isolation_level = None  # the driver must not begin transactions behind our back
        # FULL: what was answered is on the disk. With NORMAL a power cut takes back the last commits.
        for pragma in ("journal_mode=WAL", f"busy_timeout={BUSY_TIMEOUT_MS}", "foreign_keys=ON", "synchronous=FULL"):
            connection.execute(f"PRAGMA {pragma}")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        immediate = connection.get_execution_options().get("immediate", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if immediate else "BEGIN")

    return engine
