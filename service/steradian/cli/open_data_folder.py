"""Data folder and database of a command, opened without migration."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from steradian.core.settings import Settings
    from steradian.storage.db.database import Database

Data = Annotated[Path | None, typer.Option(help="The service's data folder. [default: data]")]


def folder_of(data: Path | None) -> Path:
    """Return the data folder from the option, else from the environment variable, else ``data``."""
    from steradian.core.settings import PREFIX, Settings

    return Settings.create(data=data if data is not None or f"{PREFIX}DATA" in os.environ else Path("data")).data


def open_existing_database(data: Path | None, *, reads: bool = False) -> tuple[Settings, Database]:
    """Open the service's existing database without creating or migrating tables.

    Who only ``reads`` may have a folder that cannot be written: one on a read-only file system, or another user's.
    """
    from steradian.core.exceptions import Conflict, NotFound
    from steradian.core.settings import Settings
    from steradian.storage.data_dir.layout import DataDirectory
    from steradian.storage.db.database import Database, known_revisions, metadata_url
    from steradian.storage.maintenance import folder_binding as folders
    from steradian.storage.maintenance.permissions import can_write

    settings = Settings.create(data=folder_of(data))
    folder = DataDirectory(settings.data)
    if settings.database_url is None and not folder.metadata_file.is_file():
        raise NotFound("data folder", str(folder.root))
    read_only = reads and settings.database_url is None and not can_write(folder.metadata_file)
    database = Database(metadata_url(settings), read_only=read_only)
    try:
        revision, newest = database.revision(), known_revisions()[0]
        if revision != newest:
            version = f"the database has version {revision or 'none'}, this command is for {newest}"
            raise Conflict(f"{version}; use the service's Steradian, started once")
        folders.check_binding(database, folder)
    except BaseException:
        database.close()
        raise
    return settings, database
