"""Version of the queue engine (DBOS), recorded in the database by the service that migrated the engine's tables."""

from __future__ import annotations

from importlib.metadata import version
from typing import Final

ENGINE_VERSION_FACT: Final = "queue-engine"
"""Name of the fact in the database."""


def engine_version() -> str:
    """Return the version of the installed queue engine (DBOS)."""
    return version("dbos")
