"""Safe reading of untrusted HDF5 files: no external links, and sizes are checked before reading.

Refused, naming what: links that leave the file (and soft links, which hide where they lead), groups nested without
end, virtual datasets and external storage, references, variable-length and compound values, shapes and chunks beyond
use, data that would inflate out of proportion. Only gzip is allowed as compression, because its output can be measured
piece by piece. Messages name a file without its folder: who sent it need not know where it lies.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile, NotFound, SteradianError
from steradian.scans.file.h5py_errors import HDF5_ERRORS
from steradian.scans.file.locking import open_for_reading

MAX_LINKS = 5_000_000
MOST_DEPTH = 32
"""Groups inside groups; the HDF5 library itself visits them by recursion, and thousands of them end its process."""
MOST_TEXT = 1 << 20
MOST_CHUNKS = 4_000_000
CHUNK_BYTES = 128 << 20
SMALL_BYTES = 1 << 29
"""Largest dataset that is not the A-lines: a mask over a k-Wave grid of 812³ voxels."""
TRACE_BYTES = 1 << 38
RATIO, RATIO_FROM = 200, 16 << 20
"""Data of more than ``RATIO_FROM`` bytes may not be ``RATIO`` times larger than what the file stores for them."""

LINK_KINDS = {h5py.h5l.TYPE_SOFT: "a soft link", h5py.h5l.TYPE_EXTERNAL: "a link to another file"}
FILTERS = {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32}


@contextmanager
def open_untrusted(path: Path) -> Iterator[h5py.File]:
    """Open an untrusted HDF5 or MATLAB 7.3 file for reading, after a check of all its links.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it cannot be read, holds something refused, or lacks what is asked for inside the block.
    """
    if not path.is_file():
        raise NotFound("file", path.name)
    with _open(path) as file, _damage(path):
        _check_links(file)
        yield file


@contextmanager
def open_root_only(path: Path) -> Iterator[h5py.File]:
    """Open an HDF5 file for reading names and attributes of the root group only; links are not checked.

    Raises
    ------
    DamagedFile
        When it cannot be opened.
    """
    with _open(path) as file, _damage(path):
        yield file


def name_of(file: h5py.File) -> str:
    """Return the name of an open file without its folder."""
    return Path(file.filename).name


def top_names(file: h5py.File) -> list[str]:
    """Return the names in the root group, without following links."""
    return [name.decode(errors="replace") for name in file.id]


def dataset(file: h5py.File, name: str, *, most_bytes: int = SMALL_BYTES) -> h5py.Dataset:
    """Return a numeric dataset after checks of its type, storage and size.

    Raises
    ------
    DamagedFile
        When there is none of that name, or it is refused.
    """
    with _damage(Path(file.filename)):
        found = file.get(name)
        if not isinstance(found, h5py.Dataset):
            raise DamagedFile(f"{name_of(file)} has no dataset {name!r}")
        reason = _kind(found) or _place(found) or _shape(found, most_bytes) or _chunks(found)
        reason = reason or _check_aspect(found) or _inflation(found)
    if reason:
        raise DamagedFile(f"{name_of(file)}: {name} {reason}")
    return found


def array(file: h5py.File, name: str, *, most_bytes: int = SMALL_BYTES) -> NDArray[Any]:
    """Read a whole numeric dataset after the checks of :func:`dataset`."""
    return np.asarray(dataset(file, name, most_bytes=most_bytes)[()])


def read_plain(group: h5py.Group, name: str, into: NDArray[np.float64]) -> bool:
    """Read a small uncompressed dataset into an array of the same shape; fast path of :func:`array`.

    Returns
    -------
    bool
        False for anything unusual, which :func:`array` then reads or refuses.
    """
    found = h5py.h5d.open(group.id, name.encode())
    made, kind = found.get_create_plist(), found.get_type().get_class()
    plain = made.get_layout() in (h5py.h5d.CONTIGUOUS, h5py.h5d.COMPACT) and made.get_external_count() == 0
    if not plain or found.shape != into.shape or kind not in (h5py.h5t.FLOAT, h5py.h5t.INTEGER):
        return False
    found.read(h5py.h5s.ALL, h5py.h5s.ALL, into)
    return True


def number(file: h5py.File, name: str) -> float | None:
    """Read a dataset of a single number, in an array of any shape; ``None`` if the dataset does not exist.

    Raises
    ------
    DamagedFile
        When it is no single finite number.
    """
    if name not in file:
        return None
    values = array(file, name, most_bytes=1 << 10)
    if values.size != 1 or not np.isfinite(values).all():
        raise DamagedFile(f"{name_of(file)}: {name} has the shape {values.shape}; expected one finite number")
    return float(values.reshape(-1)[0])


def text(file: h5py.File, place: str, name: str, *, most: int = MOST_TEXT) -> str | None:
    """Read a text attribute; ``None`` if it does not exist.

    Raises
    ------
    DamagedFile
        When it is something else, or longer than ``most`` characters.
    """
    kind = _attribute_kind(file, place, name)
    if kind is None:
        return None
    if h5py.check_string_dtype(kind) is None or kind.itemsize > most:
        raise DamagedFile(f"{name_of(file)}: attribute {name} of {place} is not a text of at most {most} characters")
    value = file[place].attrs[name]
    value = value.decode(errors="replace") if isinstance(value, bytes) else str(value)
    if len(value) > most:
        raise DamagedFile(f"{name_of(file)}: attribute {name} of {place} has {len(value)} characters; allowed: {most}")
    return value


def float_attribute(file: h5py.File, place: str, name: str) -> float | None:
    """Read an attribute of one finite number; like :func:`float_array_attribute`."""
    found = float_array_attribute(file, place, name, None)
    return None if found is None else found[0]


def float_array_attribute(file: h5py.File, place: str, name: str, count: int | None) -> tuple[float, ...] | None:
    """Read an attribute of ``count`` finite numbers (``None``: a single one); ``None`` if it does not exist.

    Raises
    ------
    DamagedFile
        When it is something else.
    """
    kind = _attribute_kind(file, place, name, () if count is None else (count,))
    if kind is None:
        return None
    values = np.asarray(file[place].attrs[name], np.float64) if kind.kind in "iufb" else np.array(np.nan)
    if not np.isfinite(values).all():
        raise DamagedFile(f"{name_of(file)}: attribute {name} of {place} is not finite, or no number")
    return tuple(values.reshape(-1).tolist())


def _attribute_kind(file: h5py.File, place: str, name: str, shape: tuple[int, ...] = ()) -> np.dtype[Any] | None:
    attributes = file[place].attrs
    if name not in attributes:
        return None
    found = attributes.get_id(name)
    if found.shape != shape:
        raise DamagedFile(f"{name_of(file)}: attribute {name} of {place} has the shape {found.shape}; expected {shape}")
    kind: np.dtype[Any] = found.dtype
    return kind


def _open(path: Path) -> h5py.File:
    try:
        return open_for_reading(path)
    except (OSError, *HDF5_ERRORS) as error:
        raise DamagedFile(f"{path.name} cannot be read as HDF5: {_library_message(error, path)}") from error


@contextmanager
def _damage(path: Path) -> Iterator[None]:
    """Convert the HDF5 library's errors on a broken file into ``DamagedFile``; system errors pass through."""
    try:
        yield
    except SteradianError:
        raise
    except HDF5_ERRORS as error:
        raise DamagedFile(f"{path.name} cannot be read: {_library_message(error, path)}") from error
    except OSError as error:
        if error.errno is not None:  # a full disk, say
            raise
        raise DamagedFile(f"{path.name} cannot be read: {_library_message(error, path)}") from error


def _library_message(error: Exception, path: Path) -> str:
    """Return an HDF5 error message with the file's path shortened to its name."""
    return str(error).replace(str(path), path.name)


def _check_links(file: h5py.File) -> None:
    """Check every link of the file, visiting each group once, without recursion."""
    count, known = 0, {h5py.h5o.get_info(file.id).addr}
    waiting = [(file.id, "", 0)]
    while waiting:
        group, path, depth = waiting.pop()
        found: list[tuple[bytes, int]] = []

        def note(name: bytes, info: Any, found: list[tuple[bytes, int]] = found) -> bool | None:
            found.append((name, info.type))
            return True if len(found) > MAX_LINKS else None

        group.links.iterate(note, info=True)
        count += len(found)
        for name, link in found:
            reason = _link(link) or _walk(count, depth)
            if reason:
                place = f"{path}{name.decode(errors='replace')}"
                raise DamagedFile(f"{name_of(file)}: {place} {reason}")
            about = h5py.h5o.get_info(group, name)
            if about.type == h5py.h5o.TYPE_GROUP and about.addr not in known:
                known.add(about.addr)
                inside = h5py.h5g.open(group, name)
                waiting.append((inside, f"{path}{name.decode(errors='replace')}/", depth + 1))


def _link(kind: int) -> str:
    if kind == h5py.h5l.TYPE_HARD:
        return ""
    return f"is {LINK_KINDS.get(kind, 'a link of a kind of its own')}; an imported file must hold its own data"


def _walk(count: int, depth: int) -> str:
    if count > MAX_LINKS:
        return f"is beyond the {MAX_LINKS} objects that a file may hold"
    return f"lies more than {MOST_DEPTH} groups deep" if depth > MOST_DEPTH else ""


def _kind(found: h5py.Dataset) -> str:
    kind = found.dtype
    if kind.kind in "iufb" and kind.itemsize <= 8 and kind.subdtype is None:
        return ""
    if h5py.check_ref_dtype(kind) is not None:
        words = "references to objects"
    elif h5py.check_string_dtype(kind) is not None:
        words = "text"
    elif kind.kind == "O":
        words = "values of variable length"
    else:
        words = f"values of the kind {kind}"
    return f"holds {words}; expected real numbers of at most 8 bytes"


def _place(found: h5py.Dataset) -> str:
    if found.is_virtual:
        return "is a virtual dataset, its data lie in other files; an imported file must hold its own data"
    if found.external:
        return "keeps its data in another file; an imported file must hold its own data"
    return ""


def _shape(found: h5py.Dataset, most_bytes: int) -> str:
    shape = found.shape
    if shape is None or found.ndim > 5 or 0 in shape:
        return f"has the shape {shape}; expected 1 to 5 axes, none of them empty"
    size = prod(shape) * found.dtype.itemsize
    if size > most_bytes:
        return f"has the shape {shape}, {size:.2g} bytes; allowed: at most {most_bytes:.2g}"
    return ""


def _check_aspect(found: h5py.Dataset) -> str:
    size, stored = found.size * found.dtype.itemsize, int(found.id.get_storage_size())
    if size > max(RATIO_FROM, RATIO * stored):
        return f"would be {size:.2g} bytes from {stored} in the file; allowed: {RATIO} times as many"
    return ""


def _chunks(found: h5py.Dataset) -> str:
    if found.chunks is None:
        return ""
    if prod(found.chunks) * found.dtype.itemsize > CHUNK_BYTES:
        return f"has chunks of {found.chunks}; allowed: at most {CHUNK_BYTES >> 20} MiB each"
    if prod(-(-side // step) for side, step in zip(found.shape, found.chunks, strict=True)) > MOST_CHUNKS:
        return f"has chunks of {found.chunks}, more than {MOST_CHUNKS} of them; rewrite it with larger ones"
    return ""


def _inflation(found: h5py.Dataset) -> str:
    """Return an error text if a compressed chunk inflates to more than its size; empty if all are valid."""
    made = found.id.get_create_plist()
    filters = [made.get_filter(index) for index in range(made.get_nfilters())]
    strange = [name.decode(errors="replace") or str(code) for code, _, _, name in filters if code not in FILTERS]
    codes = [code for code, *_ in filters]
    if strange or codes.count(h5py.h5z.FILTER_DEFLATE) > 1:
        return f"is compressed with {', '.join(strange) or 'gzip twice'}; allowed: gzip once, or nothing"
    if h5py.h5z.FILTER_DEFLATE not in codes:
        return ""
    skipped = 1 << codes.index(h5py.h5z.FILTER_DEFLATE)
    most = prod(found.chunks) * found.dtype.itemsize + 4  # a checksum may lie inside
    for index in range(found.id.get_num_chunks()):
        info = found.id.get_chunk_info(index)
        if info.size > most + (most >> 4) + 64:
            return f"has a chunk of {info.size} bytes for {most}"
        if not info.filter_mask & skipped and not _inflates_within(found.id, info.chunk_offset, most):
            return f"has a chunk that inflates to more than its {most} bytes, or is not gzip data"
    return ""


def _inflates_within(found: Any, offset: tuple[int, ...], most: int) -> bool:
    _, data = found.read_direct_chunk(offset)
    stream, total = zlib.decompressobj(), 0
    try:
        while not stream.eof:
            piece = stream.decompress(data, 1 << 20)
            total += len(piece)
            data = stream.unconsumed_tail
            if total > most or (not piece and not data):
                return False
    except zlib.error:
        return False
    return True
