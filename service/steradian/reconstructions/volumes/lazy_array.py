"""Reader of slices of an uncompressed HDF5 dataset, directly from the file's bytes.

The HDF5 library reads whole chunks, or single values one by one, and holds a lock for all threads meanwhile. Values of
volumes are stored as they are, so that where they lie is all one needs to know.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile

if TYPE_CHECKING:
    import h5py

Index: TypeAlias = tuple[slice | int, ...]
CHUNK_BYTES = 4 << 20
"""Most that is read at once of values that lie in one piece."""


class ChunkedDataset:
    """Uncompressed HDF5 dataset whose slices are read directly from the file's bytes, without the HDF5 library.

    Parameters
    ----------
    dataset
        Dataset of an open file whose values have all been written; the file may be closed afterwards.

    Attributes
    ----------
    chunks
        Shape of a chunk.
    places
        File offset of each chunk, by its number along each axis.

    Raises
    ------
    DamagedFile
        When values are missing or compressed.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        self.path, self.name = Path(dataset.file.filename), str(dataset.name)
        self.shape: tuple[int, ...] = dataset.shape
        self.dtype: np.dtype[Any] = dataset.dtype
        self.places: dict[tuple[int, ...], int] = {}
        self._in_one_piece = not dataset.chunks
        if dataset.chunks:
            self.chunks = tuple(dataset.chunks)
            if dataset.id.get_create_plist().get_nfilters():
                raise DamagedFile(f"{self.path.name}: {self.name} is compressed")
            dataset.id.chunk_iter(self._note)
        else:
            self.chunks = self._planes(dataset)
        if len(self.places) < math.prod(-(-n // c) for n, c in zip(self.shape, self.chunks, strict=True)):
            raise DamagedFile(f"{self.path.name}: values of {self.name} are missing")

    def _note(self, chunk: Any) -> None:
        self.places[tuple(at // c for at, c in zip(chunk.chunk_offset, self.chunks, strict=True))] = chunk.byte_offset

    def _planes(self, dataset: h5py.Dataset) -> tuple[int, ...]:
        """Return the chunk shape for a contiguous dataset (some planes), and record the file offset of each chunk."""
        begin, plane = dataset.id.get_offset(), math.prod(self.shape[1:]) * self.dtype.itemsize
        thick = min(self.shape[0], max(1, CHUNK_BYTES // plane)) if plane else 1
        if begin is not None:
            for number, first in enumerate(range(0, self.shape[0], thick)):
                self.places[(number, *(0 for _ in self.shape[1:]))] = begin + first * plane
        return (thick, *self.shape[1:])

    def read(self, index: Index) -> NDArray[Any]:
        """Return the slice ``values[index]``, as numpy would.

        A slice with a step of at least 1, or an integer, for each axis.

        Raises
        ------
        DamagedFile
            When the file ends before.
        """
        with _opened(self.path) as file:
            return self._read(file, index)

    def _read(self, file: int, index: Index) -> NDArray[Any]:
        ranges = [
            range(at, at + 1) if isinstance(at, int) else range(*at.indices(size))
            for at, size in zip(index, self.shape, strict=True)
        ]
        found = np.empty(tuple(map(len, ranges)), self.dtype)
        if found.size:
            parts = [list(_chunk_ranges(*both)) for both in zip(ranges, self.chunks, strict=True)]
            room = bytearray(math.prod(self.chunks) * self.dtype.itemsize)
            for chunk in itertools.product(*parts):
                numbers, inside, outside = zip(*chunk, strict=True)
                found[outside] = self._part(file, self.places[numbers], inside, room)
        return found[tuple(0 if isinstance(at, int) else slice(None) for at in index)]

    def _part(self, file: int, place: int, inside: tuple[range, ...], room: bytearray) -> NDArray[Any]:
        """Read a strided part of a chunk as an array, by one read from its first to its last value."""
        item = self.dtype.itemsize
        strides = [item * math.prod(self.chunks[axis + 1 :]) for axis in range(len(self.chunks))]
        first, last = (sum(at[end] * step for at, step in zip(inside, strides, strict=True)) for end in (0, -1))
        size = last - first + item
        if os.preadv(file, [memoryview(room)[:size]], place + first) < size:
            raise DamagedFile(f"{self.path.name} ends before the values of {self.name}")
        steps = [at.step * step for at, step in zip(inside, strides, strict=True)]
        return np.ndarray(tuple(map(len, inside)), self.dtype, room, strides=tuple(steps))

    def chunk(self, numbers: tuple[int, ...]) -> bytes:
        """Return the bytes of a chunk; the last chunk of a contiguous dataset is padded with zeros.

        Raises
        ------
        DamagedFile
            When the file ends before.
        """
        size = there = math.prod(self.chunks) * self.dtype.itemsize
        if self._in_one_piece:
            planes = min(self.chunks[0], self.shape[0] - numbers[0] * self.chunks[0])
            there = planes * size // self.chunks[0]
        with _opened(self.path) as file:
            data = os.pread(file, there, self.places[numbers])
        if len(data) < there:
            raise DamagedFile(f"{self.path.name} ends before the values of {self.name}")
        return data.ljust(size, b"\0")

    def iter_chunks(self, index: Index) -> Iterator[NDArray[Any]]:
        """Yield a slice in blocks of a few planes along the first axis; integer indices remove their axis.

        All are of one file, which may be deleted or replaced once the first has been read.
        """
        first, *others = index
        if isinstance(first, int):
            yield self.read(index)
            return
        planes = range(*first.indices(self.shape[0]))
        of_plane = zip(others, self.shape[1:], strict=True)
        sides = (1 if isinstance(at, int) else len(range(*at.indices(n))) for at, n in of_plane)
        thick = max(1, CHUNK_BYTES // max(1, math.prod(sides) * self.dtype.itemsize))
        with _opened(self.path) as file:
            for at in range(0, len(planes), thick):
                some = planes[at : at + thick]
                yield self._read(file, (slice(some.start, some.stop, some.step), *others))


def _chunk_ranges(wanted: range, side: int) -> Iterator[tuple[int, range, slice]]:
    """Yield, for each chunk along an axis: its number, the indices inside the chunk, and the output slice."""
    done = 0
    while done < len(wanted):
        number = wanted[done] // side
        count = len(range(wanted[done], min(wanted[-1] + 1, (number + 1) * side), wanted.step))
        begin = wanted[done] - number * side
        yield number, range(begin, begin + count * wanted.step, wanted.step), slice(done, done + count)
        done += count


@contextmanager
def _opened(path: Path) -> Iterator[int]:
    file = os.open(path, os.O_RDONLY)
    try:
        yield file
    finally:
        os.close(file)
