"""Start-up check of a worker: wait until the service has migrated the database, then verify versions and folder.

Workers never change tables: a service may be running whose code is another one.
"""

from __future__ import annotations

import logging
import time

from sqlalchemy.exc import SQLAlchemyError

from steradian.core.exceptions import Conflict, StoreUnavailable
from steradian.core.settings import Settings
from steradian.jobs.queue.engine_version import ENGINE_VERSION_FACT, engine_version
from steradian.storage import deployment_binding as belonging
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database, known_revisions, metadata_url

POLL_INTERVAL, LOG_INTERVAL = 0.5, 30.0
"""Seconds between looks at a database that is not ready, and between words about it."""
_log = logging.getLogger(__name__)


def wait_until_ready(settings: Settings) -> None:
    """Wait until a service of this version has migrated the database, and verify the data folder.

    Raises
    ------
    Conflict
        When a newer service made the database's tables.
    InvalidInput
        When the folder is not the one of the database.
    """
    told = float("-inf")
    while (missing := _unmet_precondition(settings)) is not None:
        if time.monotonic() - told > LOG_INTERVAL:
            told = time.monotonic()
            _log.warning("waiting for the service: %s", missing)
        time.sleep(POLL_INTERVAL)


def _unmet_precondition(settings: Settings) -> str | None:
    """Return the reason why a worker cannot start yet; ``None`` when it can."""
    if settings.database_url is None and not DataDirectory(settings.data).metadata_file.exists():
        return f"there is no database in {settings.data}"
    database = Database(metadata_url(settings))
    try:
        revision, known = database.revision(), known_revisions()
        if revision is not None and revision not in known:
            limit = f"this worker knows those up to {known[0]}"
            raise Conflict(f"the database has version {revision}, {limit}; install the service's Steradian")
        if revision != known[0]:
            return f"the database has version {revision or 'none'}, this worker needs {known[0]}"
        if not belonging.check_binding(settings, database):
            return "no service has used this database with a data folder or store"
        with database.read() as session:
            engine = database.get_fact(session, ENGINE_VERSION_FACT)
        if engine != engine_version():
            return f"its queue is of engine {engine or 'none'}, this worker's is {engine_version()}"
    except SQLAlchemyError as error:
        return f"the database does not answer ({error})"
    except StoreUnavailable as error:
        return str(error)
    finally:
        database.close()
    return None
