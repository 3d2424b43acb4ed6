"""MATLAB's own format before 7.3, what ``save`` writes by default (versions 5 to 7) and Octave with ``-v6`` or ``-v7``.

Read by SciPy: only variables of plain numbers that the import has a use for, never cells, objects or functions.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from steradian.errors import DamagedFile
from steradian.scans.importing.untrusted import RATIO, RATIO_FROM

MAGIC = b"MATLAB 5.0"
NUMBERS = {"double": 8, "single": 4, "logical": 1} | {f"{u}int{8 * n}": n for u in ("", "u") for n in (1, 2, 4, 8)}
"""Classes of plain numbers and their bytes."""
MOST_BYTES = 1 << 30
"""Of a variable; such a file is read whole."""
BROKEN = (
    OSError,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    ArithmeticError,
    AttributeError,
    MemoryError,
    NotImplementedError,
    zlib.error,
)
"""What SciPy raises on a broken file; it asks for as much memory as the file says at once."""


@contextmanager
def open_variables(path: Path, wanted: Iterable[str], needed: Iterable[str]) -> Iterator[h5py.File]:
    """Give variables as an HDF5 file in memory that holds them as MATLAB 7.3 would.

    Parameters
    ----------
    path
        The file.
    wanted
        Names of variables to take where they are plain numbers.
    needed
        Names one of which is what the file is read for.

    Raises
    ------
    DamagedFile
        When it cannot be read, has none of ``needed``, or a variable that is wanted is too large.
    """
    held = _held(path)
    found = next((name for name in needed if name in held), None)
    if found is None:
        raise DamagedFile(
            f"{path.name} has no variable {next(iter(needed))!r}; it holds {', '.join(held) or 'nothing'}"
        )
    if held[found][1] not in NUMBERS:
        raise DamagedFile(
            f"{path.name}: {found} is a {held[found][1]}; expected an array of numbers (of a structure: its field), "
            "or a file saved with -v7.3"
        )
    chosen = {name: about for name, about in held.items() if name in {*wanted, found} and about[1] in NUMBERS}
    for name, (shape, kind) in chosen.items():
        size = prod(shape) * NUMBERS[kind]
        if size > MOST_BYTES:
            raise DamagedFile(
                f"{path.name}: {name} has {size:.2g} bytes; allowed: {MOST_BYTES:.2g}; save it with -v7.3"
            )
        if size > max(RATIO_FROM, RATIO * path.stat().st_size):
            raise DamagedFile(
                f"{path.name}: {name} would be {size:.2g} bytes; allowed: {RATIO} times as many as the file"
            )
    with h5py.File(path.name, "w", driver="core", backing_store=False) as file:
        for name, values in _read(path, list(chosen)).items():
            file[name] = values.T
        yield file


def _held(path: Path) -> dict[str, tuple[tuple[int, ...], str]]:
    """Names of all variables with their shapes and classes."""
    from scipy.io import whosmat
    from scipy.io.matlab import MatReadError

    try:
        return {str(name): (tuple(shape), str(kind)) for name, shape, kind in whosmat(str(path), appendmat=False)}
    except (MatReadError, *BROKEN) as error:
        raise DamagedFile(f"{path.name} cannot be read as a MATLAB file: {error}") from error


def _read(path: Path, names: list[str]) -> dict[str, np.ndarray[Any, Any]]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        found = loadmat(str(path), appendmat=False, variable_names=names)
    except (MatReadError, *BROKEN) as error:
        raise DamagedFile(f"{path.name} cannot be read as a MATLAB file: {error}") from error
    for name in names:
        values = found.get(name)
        if not isinstance(values, np.ndarray) or values.dtype.kind not in "iufb":
            raise DamagedFile(f"{path.name}: {name} holds no real numbers")
    return {name: found[name] for name in names}
