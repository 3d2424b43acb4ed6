"""Binding of database, data folder and object store of one deployment, to detect mix-ups."""

from __future__ import annotations

from steradian.core.exceptions import InvalidInput
from steradian.core.settings import Settings
from steradian.storage.blobs.object_store import FACT_KEY, S3BlobStore
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.maintenance import folder_binding as folder


def bind_deployment(settings: Settings, database: Database) -> None:
    """Bind database, data folder and object store to each other; raises an error if one is bound elsewhere.

    Raises
    ------
    InvalidInput
        When one of them is bound elsewhere, or the settings lack the store to which the database is bound.
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
    """Return whether the database is bound to its store or data folder; ``False`` before a service has bound them.

    Nothing is changed. With a store, the data folder is not checked, because each host has its own. Raises like
    :func:`bind_deployment`.
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
