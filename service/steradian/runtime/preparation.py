"""Checks and migrations before a service starts, run in a child process of the supervisor.

The functions import SQLAlchemy and Alembic. The supervisor, which runs as long as the service, does not.
"""

from __future__ import annotations

import logging
from contextlib import closing, suppress
from pathlib import Path

from steradian.core.exceptions import StoreUnavailable
from steradian.core.settings import Settings
from steradian.storage.data_dir.layout import DataDirectory

_log = logging.getLogger(__name__)


def refuse_unusable(settings: Settings) -> None:
    """Raise an error if the data folder is damaged or bound to another database, before any change."""
    from sqlalchemy.exc import SQLAlchemyError

    from steradian.storage.db.database import Database, metadata_url
    from steradian.storage.deployment_binding import check_binding
    from steradian.storage.maintenance.startup_check import check_before_start, is_database

    data = DataDirectory(settings.data)
    if settings.database_url is None:
        data.metadata_url  # noqa: B018 - refuses a path that SQLite cannot open
        if not is_database(data.metadata_file):
            check_before_start(settings)
    elif settings.role == "service" and data.root.is_dir():
        with closing(Database(metadata_url(settings))) as database:
            with suppress(StoreUnavailable, SQLAlchemyError):  # which the migration reports
                check_binding(settings, database)


def refuse_foreign_folder(settings: Settings) -> None:
    """Raise an error if the data folder is bound to another database; an unavailable database is only logged."""
    from sqlalchemy.exc import SQLAlchemyError

    from steradian.storage.db.database import Database, metadata_url
    from steradian.storage.deployment_binding import check_binding

    with closing(Database(metadata_url(settings))) as database:
        try:
            check_binding(settings, database)
        except StoreUnavailable as error:
            _log.warning("%s", error)
        except SQLAlchemyError as error:
            _log.warning("the database does not answer yet: %s", error)


def migrate(settings: Settings) -> Path | None:
    """Check database and data folder, migrate the database, and bind it to the folder.

    Unknown scans are logged.

    Returns
    -------
    Path or None
        The key file, when an admin key was made and written there.

    Raises
    ------
    DamagedFile
        When the database is damaged, or a newer version made it.
    InvalidInput
        When the database is bound elsewhere, or a needed key is missing.
    """
    from steradian.security.bootstrap import require_api_key
    from steradian.storage.db.database import Database, metadata_url
    from steradian.storage.deployment_binding import bind_deployment
    from steradian.storage.maintenance.startup_check import MAX_LISTED, check_before_start

    if unknown := check_before_start(settings):
        names = ", ".join(unknown[:MAX_LISTED]) + (" …" if len(unknown) > MAX_LISTED else "")
        advice = f"`steradian check {settings.data}` lists what can be recovered"
        _log.warning("%d of the scans in the folder are not in the database (%s); %s", len(unknown), names, advice)
    with closing(Database(metadata_url(settings))) as database:
        database.migrate()
        bind_deployment(settings, database)
        return require_api_key(settings, database)
