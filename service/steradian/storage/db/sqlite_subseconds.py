"""Replacement for SQL function ``unixepoch('subsec')`` in SQLite before 3.42.

From Python 3.12 on the queue's engine writes ``unixepoch('subsec')`` into the defaults of its tables and into its
queries, whatever the SQLite below it. Before 3.42 that is NULL, and before 3.38 an unknown function; Debian 12 has
3.40 and Ubuntu 22.04 has 3.37. As the expression stands in the file, each process that writes there needs it,
whichever Python made the file; who only reads needs nothing.
"""

from __future__ import annotations

import sqlite3
import time
from typing import Any, Final

from sqlalchemy import URL, CreateEnginePlugin, Engine, event, make_url
from sqlalchemy.dialects import plugins

_PLUGIN: Final = "steradian_subseconds"


def with_subseconds(url: str) -> str:
    """Return a SQLite URL whose connections provide the SQL function ``unixepoch('subsec')``."""
    return make_url(url).update_query_pairs([("plugin", _PLUGIN)]).render_as_string(hide_password=False)


class SubsecondPlugin(CreateEnginePlugin):
    """SQLAlchemy plugin that adds ``unixepoch('subsec')`` to connections of SQLite before 3.42."""

    def __init__(self, url: URL, kwargs: dict[str, Any]) -> None:
        pass

    def update_url(self, url: URL) -> URL:
        """Return the URL unchanged, because it has no parameters for this plugin."""
        return url

    def engine_created(self, engine: Engine) -> None:
        """Add the SQL function ``unixepoch('subsec')`` to each new connection of the engine."""
        event.listen(engine, "connect", lambda connection, _record: add_subseconds(connection))


def add_subseconds(connection: sqlite3.Connection) -> None:
    """Add the SQL function ``unixepoch('subsec')`` to a connection of SQLite before 3.42."""
    if sqlite3.sqlite_version_info < (3, 42):
        connection.create_function("unixepoch", 1, _unixepoch)


def _unixepoch(text: str) -> float:
    if text != "subsec":
        raise ValueError(f"unixepoch({text!r}): only 'subsec' is known")
    return round(time.time(), 3)


plugins.register(_PLUGIN, __name__, SubsecondPlugin.__name__)
