"""HTTP responses with slices of stored arrays.

Parse NumPy index syntax, negotiate npy, raw or JSON, enforce size limits before reading.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from fastapi import Request
from fastapi.responses import Response, StreamingResponse
from numpy.typing import NDArray
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from werkzeug.datastructures import MIMEAccept
from werkzeug.http import parse_accept_header

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.core.json_encoding import nan_to_none
from steradian.scans.file.h5py_errors import HDF5_ERRORS
from steradian.scans.file.locking import open_for_reading

NPY: Final = "application/x-npy"
RAW: Final = "application/octet-stream"
JSON: Final = "application/json"
CSV: Final = "text/csv"
PNG: Final = "image/png"
PICTURE: Final[dict[str, Any]] = {PNG: {"schema": {"type": "string", "format": "binary"}}}
CHUNK_BYTES: Final = 4 * 2**20
MAX_JSON_VALUES: Final = 100_000
_PART = re.compile(r"\s*(?:(-?[0-9]{1,12})|(-?[0-9]{1,12})?:(-?[0-9]{1,12})?(?::([0-9]{1,12})?)?)\s*")


class ArrayView(BaseModel):
    """Response schema of an array slice."""

    shape: list[int] = Field(description="One number for each axis that is left")
    dtype: str = Field(description="Type of the values as NumPy writes it")
    values: list[Any] | float | None = Field(
        description="Nested lists, one level per axis; null for values that are not finite"
    )


ARRAY_ANSWER: Final[dict[str, Any]] = {
    "model": ArrayView,
    "content": {kind: {"schema": {"type": "string", "format": "binary"}} for kind in (NPY, RAW)},
}
"""Formats of an array in the document."""


def negotiate(request: Request, offered: tuple[str, ...]) -> str:
    """Return the offered media type that the Accept header prefers; the first one offered without a preference.

    Raises
    ------
    HTTPException
        406 with the offered media types, when the client accepts none of them.
    """
    stated = ", ".join(request.headers.getlist("accept")) or "*/*"
    accepted = parse_accept_header(stated, MIMEAccept)
    # None of what there is has parameters; a charset, which some clients add, asks for nothing else.
    plain = MIMEAccept([(kind.partition(";")[0], weight) for kind, weight in accepted])
    chosen = plain.best_match(offered)
    if chosen is None:
        raise HTTPException(406, f"this can be had as {', '.join(offered)}")
    return chosen


@dataclass(frozen=True)
class ArraySlice:
    """Parsed NumPy-style index expression for an array of known shape.

    Attributes
    ----------
    index
        A slice, or an integer that takes the axis away, for each axis.
    shape
        Shape of the result.
    """

    index: tuple[slice | int, ...]
    shape: tuple[int, ...]

    @classmethod
    def parse(cls, text: str | None, shape: tuple[int, ...], field: str = "slice") -> ArraySlice:
        """Parse NumPy index syntax (``10:20,::2,5``) for an array of a shape; missing axes are selected whole.

        Raises
        ------
        InvalidInput
            When the text is not an index expression or exceeds the array.
        """
        parts = text.split(",") if text and text.strip() else []
        allowed = f"up to {len(shape)} of start:stop:step or index, comma-separated, steps of at least 1; {shape=}"
        if len(parts) > len(shape):
            raise InvalidInput(field, text, allowed)
        index: list[slice | int] = []
        for part, size in zip(parts + [":"] * (len(shape) - len(parts)), shape, strict=True):
            found = _PART.fullmatch(part)
            if found is None or (found[4] and int(found[4]) == 0):
                raise InvalidInput(field, text, allowed)
            if found[1] is not None:
                at = int(found[1])
                if not -size <= at < size:
                    raise InvalidInput(field, text, allowed)
                index.append(at % size)
            else:
                start, stop, step = (int(number) if number else None for number in found.group(2, 3, 4))
                index.append(slice(*slice(start, stop, step).indices(size)))
        return cls.point(tuple(index))

    @classmethod
    def point(cls, index: tuple[slice | int, ...]) -> ArraySlice:
        """Create an array slice from non-negative indices and slices, and compute the shape of its result."""
        return cls(index, tuple(len(range(*s.indices(10**12))) for s in index if isinstance(s, slice)))

    @property
    def count(self) -> int:
        """Number of selected elements."""
        return math.prod(self.shape)


class ChunkedArray(Protocol):
    """Protocol of arrays that can be read chunk by chunk along the first axis.

    Attributes
    ----------
    shape, dtype
        As of a NumPy array.
    """

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of elements along each axis."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """NumPy data type of the elements."""
        ...

    def iter_chunks(self, index: tuple[slice | int, ...]) -> Iterator[NDArray[Any]]:
        """Yield the selected part in chunks along the first axis."""
        ...


class InMemoryArray:
    """ChunkedArray backed by a NumPy array in memory."""

    def __init__(self, values: NDArray[Any]) -> None:
        self._values, self.shape, self.dtype = values, values.shape, values.dtype

    def iter_chunks(self, index: tuple[slice | int, ...]) -> Iterator[NDArray[Any]]:
        """Yield the elements that ``index`` selects as one array."""
        yield self._values[index]


class Hdf5Array:
    """ChunkedArray backed by an HDF5 dataset, which may still be written to.

    Raises
    ------
    FileNotFoundError
        When the file does not exist.
    DamagedFile
        When the file cannot be read.
    """

    def __init__(self, path: Path, name: str) -> None:
        self._path, self._name = path, name
        try:
            with open_for_reading(path) as file:
                self.shape: tuple[int, ...] = file[name].shape
                self.dtype: np.dtype[Any] = file[name].dtype
        except FileNotFoundError:
            raise
        except (OSError, *HDF5_ERRORS) as error:
            raise DamagedFile(f"{path.name} cannot be read: {error}") from error

    def iter_chunks(self, index: tuple[slice | int, ...]) -> Iterator[NDArray[Any]]:
        """Yield the selected part in chunks along the first axis, so that no request holds a whole scan in memory."""
        first, *others = index
        with open_for_reading(self._path) as file:
            if isinstance(first, int):
                yield np.asarray(file[self._name][index])
                return
            rows = range(*first.indices(self.shape[0]))
            count = len(rows) * math.prod(len(range(*at.indices(10**12))) for at in others if isinstance(at, slice))
            step = max(1, CHUNK_BYTES * len(rows) // max(1, count * self.dtype.itemsize))
            for at in range(0, len(rows), step):
                piece = rows[at : at + step]
                yield np.asarray(file[self._name][(slice(piece.start, piece.stop, piece.step), *others)])


def array_response(
    source: ChunkedArray,
    selection: ArraySlice,
    kind: str,
    *,
    limit: int,
    headers: dict[str, str] | None = None,
    more: dict[str, Any] | None = None,
    field: str = "slice",
) -> Response:
    """Return a response with a slice of an array as npy, raw bytes or JSON; large slices are streamed.

    Parameters
    ----------
    kind
        :data:`NPY`, :data:`RAW` or :data:`JSON`.
    limit
        Maximum size in bytes.
    more
        Further members of a JSON response.
    field
        The parameter to change where the part is too large.

    Raises
    ------
    InvalidInput
        When the part is too large.
    """
    shape, dtype = selection.shape, source.dtype
    size = selection.count * dtype.itemsize
    if kind == JSON and selection.count > MAX_JSON_VALUES:
        allowed = f"at most {MAX_JSON_VALUES} values as JSON; {NPY} has no limit"
        raise InvalidInput(field, " × ".join(map(str, shape)), allowed)
    if size > limit:
        raise InvalidInput(field, " × ".join(map(str, shape)), f"at most {limit} bytes, not {size}")
    about = (headers or {}) | {"X-Shape": ",".join(map(str, shape)), "X-Dtype": dtype.str}
    pieces = source.iter_chunks(selection.index) if selection.count else iter(())
    if kind == JSON:
        values = np.concatenate([np.atleast_1d(piece).ravel() for piece in pieces] or [np.empty(0, dtype)])
        body = {"shape": shape, "dtype": dtype.str, "values": nan_to_none(values.reshape(shape))} | (more or {})
        return Response(json.dumps(body), media_type=JSON, headers=about)
    head = _npy_header(dtype, shape) if kind == NPY else b""
    if size <= CHUNK_BYTES:  # as one piece: each of a stream changes threads
        return Response(b"".join(_bytes(head, pieces)), media_type=kind, headers=about)
    about["Content-Length"] = str(len(head) + size)
    first = next(pieces)  # which opens the file: one that is gone is told before the answer begins
    return StreamingResponse(_bytes(head, chain([first], pieces)), media_type=kind, headers=about)


def _npy_header(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    header = io.BytesIO()
    about = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(header, about)
    return header.getvalue()


def _bytes(head: bytes, pieces: Iterator[NDArray[Any]]) -> Iterator[bytes]:
    if head:
        yield head
    for piece in pieces:
        yield np.ascontiguousarray(piece).tobytes()
