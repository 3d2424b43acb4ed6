"""Nodes that start at once on an empty database: somebody is let in, by one key."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from sqlalchemy import text

from steradian.core.settings import Settings
from steradian.security.bootstrap import require_api_key
from steradian.security.keys import KeyStore
from steradian.storage.db.database import Database, metadata_url

pytestmark = pytest.mark.long


def test_of_several_nodes_that_start_at_once_one_makes_the_first_key(postgres, tmp_path):
    url = postgres.database()
    reached = {"data": tmp_path, "host": "0.0.0.0", "database_url": url}  # noqa: S104
    settings = [Settings.create(**reached, key_file=tmp_path / f"{node}.key") for node in range(8)]
    databases = [Database(metadata_url(each)) for each in settings]
    databases[0].migrate()
    ready = threading.Barrier(len(settings))

    def start(each, database):
        with database.read() as session:  # who is connected begins at once
            session.execute(text("SELECT 1"))
        ready.wait(250)
        return require_api_key(each, database)

    try:
        with ThreadPoolExecutor(len(settings)) as nodes:
            made = [path for path in nodes.map(start, settings, databases) if path is not None]
        (key,) = KeyStore(databases[0]).list()
        (path,) = made
        assert KeyStore(databases[0]).check(path.read_text().strip()).key_id == key.id
        assert sorted(tmp_path.glob("*.key")) == made, "no file says what opens nothing"
    finally:
        for database in databases:
            database.close()
