"""Binding of a data folder to a database by a shared identifier.

The binding detects a data folder that is not mounted on another host: its mount point is an empty folder, in which
every job would fail permanently.
"""

from __future__ import annotations

import uuid
from typing import Final

from steradian.core.atomic_files import write_durably
from steradian.core.exceptions import InvalidInput
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database

FACT_KEY: Final = "folder"


def bind_folder(database: Database, data: DataDirectory) -> None:
    """Bind a data folder to a database by a shared identifier; raises an error if either is bound elsewhere.

    Raises
    ------
    InvalidInput
        When either is bound elsewhere.
    """
    with database.write() as session:
        known, found = database.get_fact(session, FACT_KEY), data.identity
        if known is not None and found != known and not (found is None and database.is_file):
            raise _mismatch_error(data, known)
        identity = known or found or uuid.uuid4().hex
        if found is None:
            write_durably(data.identity_file, identity)  # before the database says so
        if known is None:
            database.set_fact(session, FACT_KEY, identity)


def check_binding(database: Database, data: DataDirectory) -> bool:
    """Return whether the folder is bound to the database; ``False`` before a service has bound them.

    Raises
    ------
    InvalidInput
        When the database belongs to another folder.
    """
    with database.read() as session:
        known = database.get_fact(session, FACT_KEY)
    if known is not None and data.identity != known:
        raise _mismatch_error(data, known)
    return known is not None


def _mismatch_error(data: DataDirectory, known: str) -> InvalidInput:
    name = data.identity_file.name
    if data.identity_file.is_file() and data.identity is None:
        how = f"if it is the folder of this database, write {known} into its file {name}, emptied by a power cut"
        return InvalidInput("data", data.root, how)
    which = f"the data folder of this database, whose file {name} contains {known}"
    return InvalidInput("data", data.root, f"{which}; is it mounted there?")
