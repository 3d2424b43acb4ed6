"""Conversion of SQLite file paths to SQLAlchemy URLs and ``file:`` URIs.

A folder's name may hold every character that an address gives a meaning to: ``?``, ``#``, ``%``, ``&``, quotes.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final
from urllib.parse import quote

from sqlalchemy import URL, make_url

from steradian.core.exceptions import InvalidInput

LONGEST: Final = 504
"""Bytes of a path that SQLite opens on POSIX: its limit of 512 less the ending ``-journal``."""


def sqlite_url(path: Path, field: str = "data") -> str:
    """Return the SQLAlchemy URL of a SQLite file; ``field`` is the parameter named in errors.

    Raises
    ------
    InvalidInput
        When the path is longer than SQLite opens, or no text, or this SQLAlchemy (before 2.1) cannot name it.
    """
    _check_path(path, field)
    url = URL.create("sqlite", database=str(path)).render_as_string()
    if make_url(url).database != str(path):
        raise InvalidInput(field, path.parent, 'a folder without "?" in its path, or SQLAlchemy from 2.1 on')
    return url


def file_uri(path: Path, *, immutable: bool = False) -> str:
    """Return the URI that opens a SQLite file read-only.

    Parameters
    ----------
    immutable
        Whether the file is known not to change: SQLite then needs no files beside it.
    """
    return f"file:{quote(str(path))}?mode=ro" + ("&immutable=1" if immutable else "")


def _check_path(path: Path, field: str) -> None:
    try:
        size = len(str(path).encode())
    except UnicodeEncodeError:
        raise InvalidInput(field, ascii(str(path.parent)), "a folder whose path is UTF-8 text") from None
    if os.name == "posix" and size > LONGEST:
        rest = len(path.name) + 1
        allowed = f"a folder whose path has at most {LONGEST - rest} bytes, for SQLite (it has {size - rest})"
        raise InvalidInput(field, path.parent, allowed)
