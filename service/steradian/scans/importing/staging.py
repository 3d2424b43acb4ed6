"""Staging of uploaded files in a folder with the file names that the importers expect."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def stage_upload(
    folder: Path, description: Mapping[str, Any] | None, upload: Path, companion: Path | None = None
) -> tuple[Path, Path | None]:
    """Create links to uploaded files, and the description, with the file names that the importers expect.

    Parameters
    ----------
    folder
        Where links to them and the description are put.
    description
        What the file itself does not say.
    upload, companion
        The recording; positions or k-Wave's input file.

    Returns
    -------
    tuple of Path
        The recording, and its description where there is one.
    """
    source = folder / ("source.csv" if _is_text(upload) else "source")
    source.unlink(missing_ok=True)
    source.symlink_to(upload)
    said = dict(description or {})
    if companion is not None:
        beside = folder / "companion"
        beside.unlink(missing_ok=True)
        beside.symlink_to(companion)
        said["positions"] = beside.name
    if not said:
        return source, None
    path = folder / "description.json"
    path.write_text(json.dumps(said))
    return source, path


def _is_text(path: Path) -> bool:
    with path.open("rb") as file:
        begin = file.read(1024)
    return b"\0" not in begin and begin.isascii() and begin[:1] != b"\x89" and begin[:2] != b"PK"
