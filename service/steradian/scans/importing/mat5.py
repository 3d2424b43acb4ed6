"""Reader of MATLAB files of versions 5 to 7 (before HDF5), also from Octave (``-v6``, ``-v7``).

Read by SciPy: only variables of plain numbers that the import has a use for, and such fields of structures; never
cells, objects or functions.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from steradian.core.exceptions import DamagedFile
from steradian.scans.importing.untrusted import RATIO, RATIO_FROM

MAGIC = b"MATLAB 5.0"
NUMBERS = {"double": 8, "single": 4, "logical": 1} | {f"{u}int{8 * n}": n for u in ("", "u") for n in (1, 2, 4, 8)}
"""Classes of plain numbers and their bytes."""
STRUCTURE, COMPRESSED = "struct", 15
ADVICE = {"cell": "{0} = {0}{{1}}, or cell2mat({0})", "sparse": "full({0})", "char": "str2num({0})"}
"""What makes plain numbers of other classes."""
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
    """Yield variables of a MATLAB 5 to 7 file as an in-memory HDF5 file in the layout of MATLAB 7.3.

    Parameters
    ----------
    path
        The file.
    wanted
        Names of variables to take where they are plain numbers; fields of structures as ``kgrid/dx``.
    needed
        Names one of which is what the file is read for.

    Raises
    ------
    DamagedFile
        When it cannot be read, has none of ``needed``, or a variable that is wanted is too large.
    """
    held, wanted, needed = _held(path), list(wanted), list(needed)
    found = next((name for name in needed if name.split("/")[0] in held), None)
    if found is None:
        raise DamagedFile(f"{path.name} has no variable {needed[0]!r}; it holds {', '.join(held) or 'nothing'}")
    root = found.split("/")[0]
    if held[root][1] not in (*NUMBERS, STRUCTURE):
        raise DamagedFile(
            f"{path.name}: {found} is a {held[root][1]}; expected an array of numbers: save it as one, such as "
            f"{ADVICE.get(held[root][1], 'double(' + root + ')').format(root)}"
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
    paths = {*(name for name in wanted if "/" in name), *(f"{name}/p" for name in needed), *needed}
    structures = [name for name in {each.split("/")[0] for each in paths} if held.get(name, ((), ""))[1] == STRUCTURE]
    with h5py.File(path.name, "w", driver="core", backing_store=False) as file:
        for name, values in _read(path, list(chosen)).items():
            file[name] = values.T
        for name, values in _fields(path, structures, paths).items():
            file[name] = values.T
        if found not in file and f"{found}/p" not in file:
            told = ", ".join(f"{root}.{field}" for field in _field_names(path, root)) or "none"
            raise DamagedFile(
                f"{path.name}: {found.replace('/', '.')} is no array of numbers; the fields of {root} are {told}; a "
                'description names one, "array": "structure.field"'
            )
        yield file


def _held(path: Path) -> dict[str, tuple[tuple[int, ...], str]]:
    """Return the shapes and classes of all variables in the file, by name."""
    from scipy.io import whosmat
    from scipy.io.matlab import MatReadError

    try:
        return {str(name): (tuple(shape), str(kind)) for name, shape, kind in whosmat(str(path), appendmat=False)}
    except (MatReadError, *BROKEN) as error:
        raise DamagedFile(f"{path.name} cannot be read as a MATLAB file: {error}") from error


def _require_sizes(path: Path, structures: list[str], held: list[str]) -> None:
    """Raise an error for structures with too large an inflated size, because SciPy does not report it."""
    sizes = _element_sizes(path)
    if len(sizes) != len(held):
        raise DamagedFile(f"{path.name} has {len(sizes)} elements for {len(held)} variables")
    for name in structures:
        stored, whole = sizes[held.index(name)]
        if whole > MOST_BYTES or whole > max(RATIO_FROM, RATIO * stored):
            raise DamagedFile(f"{path.name}: {name} would be {whole:.2g} bytes from {stored} in the file")


def _element_sizes(path: Path) -> list[tuple[int, int]]:
    """Return the stored and the inflated size of each data element, in bytes, from the element tags."""
    found, size = [], path.stat().st_size
    with path.open("rb") as file:
        file.seek(126)
        endian = "<" if file.read(2) == b"IM" else ">"
        while file.tell() + 8 <= size:
            kind, count = struct.unpack(f"{endian}II", file.read(8))
            start, whole = file.tell(), count
            if kind == COMPRESSED:
                head = zlib.decompressobj().decompress(file.read(min(count, 1024)), 8)
                whole = struct.unpack(f"{endian}II", head)[1] if len(head) == 8 else count
            if not (kind == COMPRESSED and whole == 0):
                found.append((count, whole))
            file.seek(start + count)
    return found


def _fields(path: Path, structures: list[str], paths: set[str]) -> dict[str, np.ndarray[Any, Any]]:
    """Return the numeric fields of structures at the requested paths."""
    if not structures:
        return {}
    found = {}
    loaded = _structures(path, structures)
    for name in sorted(paths):
        root, *fields = name.split("/")
        value: Any = loaded.get(root)
        for field in fields:
            value = _one(value)
            value = getattr(value, field, None) if field in getattr(value, "_fieldnames", ()) else None
        if fields and isinstance(value, np.ndarray) and value.dtype.kind in "iufb" and value.size:
            found[name] = value
    return found


def _field_names(path: Path, root: str) -> list[str]:
    return list(getattr(_one(_structures(path, [root]).get(root)), "_fieldnames", ()))


def _one(value: Any) -> Any:
    """Return the structure from an array of shape (1, 1); other values unchanged."""
    return (
        value.reshape(-1)[0] if isinstance(value, np.ndarray) and value.dtype == object and value.size == 1 else value
    )


def _structures(path: Path, names: list[str]) -> dict[str, Any]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        _require_sizes(path, names, list(_held(path)))
        return loadmat(str(path), appendmat=False, variable_names=names, struct_as_record=False, squeeze_me=False)
    except (MatReadError, struct.error, *BROKEN) as error:
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
