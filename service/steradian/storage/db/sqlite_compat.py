"""``unixepoch('subsec')`` for SQLite before 3.42.

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
    """Return an SQLite URL whose engines provide ``unixepoch('subsec')`` on every connection."""
    return make_url(url).update_query_pairs([("plugin", _PLUGIN)]).render_as_string(hide_password=False)


class SubsecondPlugin(CreateEnginePlugin):
    """Adds the function to the connections of an engine, where SQLite has none of its own."""

    def __init__(self, url: URL, kwargs: dict[str, Any]) -> None:
        pass

    def update_url(self, url: URL) -> URL:
        """Return the URL unchanged: it has no parameters for this plugin."""
        return url

    def engine_created(self, engine: Engine) -> None:
        """Register a hook that prepares each new connection of the engine."""
        event.listen(engine, "connect", lambda connection, _record: add_subseconds(connection))


def add_subseconds(connection: sqlite3.Connection) -> None:
    """Teach one connection the function, where its SQLite has none of its own."""
    if sqlite3.sqlite_version_info < (3, 42):
        connection.create_function("unixepoch", 1, _unixepoch)


def _unixepoch(text: str) -> float:
    if text != "subsec":
        raise ValueError(f"unixepoch({text!r}): only 'subsec' is known")
    return round(time.time(), 3)


plugins.register(_PLUGIN, __name__, SubsecondPlugin.__name__)
