"""Readers and writers of masks and plans as JSON files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import DamagedFile, NotFound
from steradian.core.validation import Value
from steradian.core.validation_errors import to_invalid_input

ModelT = TypeVar("ModelT", bound=Value)


def read_json(kind: type[ModelT], path: Path) -> ModelT:
    """Read a mask or a plan from a JSON file.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is not JSON.
    InvalidInput
        When a value in it is out of range.
    """
    if not path.is_file():
        raise NotFound("file", str(path))
    try:
        text = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise DamagedFile(f"{path} is not JSON: {error}") from error
    try:
        return kind.model_validate(text)
    except ValidationError as error:
        raise to_invalid_input(kind, error) from error


def write_json(value: Value, path: Path) -> None:
    """Write a mask or a plan into a JSON file by an atomic write."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        file.write_text(value.model_dump_json() + "\n", encoding="utf-8")
