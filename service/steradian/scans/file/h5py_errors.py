"""Translation of h5py errors on damaged files to DamagedFile."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from steradian.core.exceptions import DamagedFile, SteradianError

HDF5_ERRORS: Final = (KeyError, IndexError, RuntimeError, ValueError, TypeError, AttributeError, OverflowError)
"""Beside ``OSError``; a dataset may have turned into a type or a group, and a text that is none is a ``ValueError``.

``InvalidInput`` is a ``ValueError``, too: where a block refuses anything, ``SteradianError`` is let through before.
"""


@contextmanager
def reraise_as_damaged(path: Path | str, kind: str) -> Iterator[None]:
    """Context manager that converts errors of reading a file of a ``kind`` into :class:`DamagedFile`.

    Refusals pass through.
    """
    try:
        yield
    except SteradianError:
        raise
    except (OSError, *HDF5_ERRORS) as error:
        raise DamagedFile(f"{path} cannot be read as a {kind}: {error}") from error
