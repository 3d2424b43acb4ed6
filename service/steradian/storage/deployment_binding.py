"""Verify that database, data folder and object store belong to the same deployment."""

from __future__ import annotations

from steradian.core.exceptions import InvalidInput
from steradian.core.settings import Settings
from steradian.storage.blobs.object_store import FACT_KEY, S3BlobStore
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.maintenance import binding as folder


def bind_deployment(settings: Settings, database: Database) -> None:
    """Make them belong together, unless one of them belongs elsewhere already; for the service.

    Raises
    ------
    InvalidInput
        When it does, or a store is missing in the settings that the database names.
    StoreUnavailable
        When the store does not answer.
    """
    with database.migrating():  # two nodes that start at once take turns
        if settings.role == "service":  # else each node has a folder of its own
            folder.bind_folder(database, DataDirectory(settings.data))
        if settings.store is None:
            _refuse_without_store(database)
        else:
            S3BlobStore(settings, database).bind()


def check_binding(settings: Settings, database: Database) -> bool:
    """Whether database and store are bound to each other; ``False`` while no service has bound them. Changes nothing.

    With a store a host's data folder is its own. Raises like :func:`bind_deployment`.
    """
    if settings.store is not None:
        return S3BlobStore(settings, database).check()
    _refuse_without_store(database)
    return folder.check_binding(database, DataDirectory(settings.data))


def _refuse_without_store(database: Database) -> None:
    with database.read() as session:
        if database.get_fact(session, FACT_KEY) is not None:
            how = "the store that has this database's scans; `steradian storage move folder` brings them back"
            raise InvalidInput("STERADIAN_STORE", "missing", how)
