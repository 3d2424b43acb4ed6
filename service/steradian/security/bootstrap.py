"""Start-up check that an API key exists where one is required; creates the first admin key in a key file."""

from __future__ import annotations

import os
from pathlib import Path

from steradian.core.exceptions import InvalidInput
from steradian.core.settings import Settings
from steradian.security.keys import KeyStore, Scope
from steradian.storage.db.database import Database


def require_api_key(settings: Settings, database: Database) -> Path | None:
    """Check that an API key exists if one is required; create the first key if a key file is configured.

    Returns
    -------
    Path or None
        The settings' key file, when an admin key was made and written there.

    Raises
    ------
    InvalidInput
        Naming the ways to make one.
    """
    keys = KeyStore(database, fixed=settings.api_key)
    if not settings.needs_key or keys.any_exists():
        return None
    if settings.key_file is None:
        ways = "make a key first: steradian key create, STERADIAN_API_KEY or STERADIAN_KEY_FILE"
        if settings.require_key:
            raise InvalidInput("require_key", True, f"false, or {ways}")
        raise InvalidInput("host", settings.host, f"127.0.0.1, or {ways}")
    path = settings.key_file
    path.parent.mkdir(parents=True, exist_ok=True)
    return path if keys.create_first("first start", [Scope.ADMIN], lambda key: _write(path, key)) else None


def _write(path: Path, key: str) -> None:
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
        file.write(key + "\n")
