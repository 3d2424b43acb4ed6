"""Configuration of the queue engine (DBOS): database URL, queue names, migrations.

:mod:`steradian.jobs.queue.queue_client` is the client side, :mod:`steradian.jobs.worker.main` a worker's; no other
module uses the engine. The engine decides which worker runs a job and when; the state of a job is in the ledger.
"""

from __future__ import annotations

import logging
from typing import Final

from dbos import DBOS
from sqlalchemy import make_url

from steradian.core.settings import Settings
from steradian.jobs.queue.engine_version import ENGINE_VERSION_FACT, engine_version
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.advisory_locks import TIMEOUTS
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.db.sqlite_subseconds import with_subseconds
from steradian.storage.deployment_binding import bind_deployment

APPLICATION: Final = "steradian"
APPLICATION_VERSION: Final = "1"
"""Constant, or the engine leaves jobs of another build alone."""
QUEUE: Final = "jobs"
"""Everybody's queue. Beside it, each scanner whose node has workers has one for the images that grow with its scans."""
WORKFLOW: Final = "job"


def queue_url(settings: Settings) -> str:
    """Return the URL of the queue engine's database, which is the metadata database."""
    if settings.database_url is None:
        return with_subseconds(metadata_url(settings))
    timeouts = {name: str(value) for name, value in TIMEOUTS.items()}
    return make_url(settings.database_url).update_query_dict(timeouts).render_as_string(hide_password=False)


def migrate_queue(settings: Settings) -> str:
    """Migrate the tables of ledger and queue engine, and return the engine's URL; workers do not call this.

    Raises
    ------
    InvalidInput
        When the database belongs to another data folder or store.
    """
    DataDirectory(settings.data).create()
    logging.getLogger("dbos").setLevel(logging.WARNING)
    database = Database(metadata_url(settings))
    try:
        database.migrate()
        bind_deployment(settings, database)
        with database.migrating():
            DBOS.migrate(queue_url(settings))
        with database.write() as session:
            database.set_fact(session, ENGINE_VERSION_FACT, engine_version())
    finally:
        database.close()
    return queue_url(settings)


def workflow_table(database: Database) -> str:
    """Return the name of the database table in which the queue engine stores jobs."""
    return "workflow_status" if database.is_file else "dbos.workflow_status"


def scanner_queue(scanner_id: str) -> str:
    """Return the name of the queue for the workers of one scanner's node."""
    return f"{QUEUE}-{scanner_id}"
