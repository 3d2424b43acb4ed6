"""Lazy imports of optional libraries for export formats (the extra ``export``)."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from steradian.core.exceptions import InvalidInput

BUILTIN_FORMATS = "hdf5, nrrd, vtkhdf or png"


def import_optional(name: str, format: str) -> Any:
    """Import the optional library of an export format.

    Raises
    ------
    InvalidInput
        Naming the command that installs it.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise InvalidInput(
            "format",
            format,
            f"{BUILTIN_FORMATS}; {format} needs {name}, which pip install 'steradian[export]' installs",
        ) from error
