"""Tables of A-lines in a file, read in blocks of bounded size.

A table gives (M, N_t) A-lines, point by point, whatever the order in which its file keeps them. Where the file has
time first and cannot be read by columns (compressed, chunked by time step, a text, a zip member), its numbers go
through an uncompressed scratch file beside the destination, which is gone when the import ends.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Protocol

import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile

BLOCK_BYTES = 8 << 20

Block = tuple[int, NDArray[Any]]
"""Row of the first A-line, and A-lines (B, N_t)."""


class TraceBlocks(Protocol):
    """Protocol of a table of A-lines that is read in blocks; row f·M + m is point m of frame f."""

    @property
    def points(self) -> int: ...  # noqa: D102
    @property
    def frames(self) -> int: ...  # noqa: D102
    @property
    def samples(self) -> int: ...  # noqa: D102
    @property
    def dtype(self) -> np.dtype[Any]: ...  # noqa: D102
    def blocks(self) -> Iterator[Block]: ...  # noqa: D102


@dataclass(frozen=True)
class RawTraceBlocks:
    """Table of A-lines stored as contiguous raw numbers in a file, in either axis order.

    Parameters
    ----------
    file
        Open for reading, with a descriptor.
    offset
        Where the numbers begin, in bytes.
    dtype, points, samples
        Their kind and count.
    time_first
        Whether the file holds (N_t, M) in C order; else (M, N_t).
    """

    file: IO[bytes]
    offset: int
    dtype: np.dtype[Any]
    points: int
    samples: int
    time_first: bool
    frames: int = 1

    def blocks(self) -> Iterator[Block]:
        """Yield all A-lines in blocks, in order."""
        step = max(1, BLOCK_BYTES // (self.samples * self.dtype.itemsize))
        for start in range(0, self.points, step):
            count = min(step, self.points - start)
            yield start, (self._columns(start, count) if self.time_first else self._rows(start, count))

    def _rows(self, start: int, count: int) -> NDArray[Any]:
        length = self.samples * self.dtype.itemsize
        data = self._read(self.offset + start * length, count * length)
        return np.frombuffer(data, self.dtype).reshape(count, self.samples)

    def _columns(self, start: int, count: int) -> NDArray[Any]:
        item, found = self.dtype.itemsize, np.empty((self.samples, count), self.dtype)
        for time in range(self.samples):
            place = self.offset + (time * self.points + start) * item
            found[time] = np.frombuffer(self._read(place, count * item), self.dtype)
        return np.ascontiguousarray(found.T)

    def _read(self, offset: int, length: int) -> bytes:
        self.file.seek(offset)
        data = self.file.read(length)
        if len(data) != length:
            raise DamagedFile(
                f"{self.file.name} is truncated: {length} bytes expected at {offset}, {len(data)} present"
            )
        return data


@dataclass(frozen=True)
class Hdf5TraceBlocks:
    """Table of A-lines in an HDF5 dataset (M, N_t, …); each further index is a frame."""

    dataset: h5py.Dataset
    further: tuple[tuple[int, ...], ...] = ((),)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.further)

    @property
    def points(self) -> int:
        """Number of A-lines in a frame."""
        return int(self.dataset.shape[0])

    @property
    def samples(self) -> int:
        """Number of samples of an A-line."""
        return int(self.dataset.shape[1])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Data type of the samples."""
        kind: np.dtype[Any] = np.dtype(self.dataset.dtype)
        return kind

    def blocks(self) -> Iterator[Block]:
        """Yield all A-lines in blocks, in order; blocks are whole HDF5 chunks if these are small enough."""
        row = int(np.prod(self.dataset.shape[1:])) * self.dtype.itemsize
        step = max(1, BLOCK_BYTES // row)
        whole = self.dataset.chunks[0] if self.dataset.chunks else 1
        step = max(step // whole * whole, min(whole, 4 * step))
        for frame, indices in enumerate(self.further):
            for start in range(0, self.points, step):
                block = self.dataset[(slice(start, start + step), slice(None), *indices)]
                yield frame * self.points + start, block


def temporary_file(folder: Path | None) -> IO[bytes]:
    """Open an anonymous temporary file, which the system deletes when it is closed."""
    return tempfile.TemporaryFile(dir=folder, prefix=".import-")


def spill_to_disk(
    pieces: Iterator[NDArray[Any]], file: IO[bytes], points: int, samples: int, *, time_first: bool
) -> RawTraceBlocks:
    """Write pieces of an array to a temporary file and return it as a table of A-lines.

    Parameters
    ----------
    pieces
        Arrays of one kind; together points × samples numbers.
    file
        From :func:`temporary_file`.
    points, samples, time_first
        Shape and order of the whole.

    Raises
    ------
    DamagedFile
        When there are fewer or more numbers than that.
    """
    kind, total = None, 0
    for piece in pieces:
        kind = piece.dtype
        total += piece.size
        if total > points * samples:
            break
        file.write(np.ascontiguousarray(piece).tobytes())
    if kind is None or total != points * samples:
        raise DamagedFile(f"the A-lines end after {total} numbers; expected {points} × {samples}")
    file.flush()
    return RawTraceBlocks(file, 0, kind, points, samples, time_first)


def mapped(
    file: IO[bytes], offset: int, kind: np.dtype[Any], shape: tuple[int, ...], *, fortran: bool = False
) -> NDArray[Any]:
    """Memory-map contiguous numbers of a file as an array.

    Raises
    ------
    DamagedFile
        When there are fewer numbers than that, or more than the address space holds.
    """
    try:
        return np.memmap(file, kind, "r", offset, shape, "F" if fortran else "C")
    except (ValueError, OSError, OverflowError) as error:
        raise DamagedFile(f"the A-lines cannot be read in this order of axes: {error}") from error


def iter_slabs(dataset: h5py.Dataset) -> Iterator[NDArray[Any]]:
    """Yield slabs of an HDF5 dataset along its first axis, a few megabytes each, in whole chunks."""
    row = max(1, int(np.prod(dataset.shape[1:])) * dataset.dtype.itemsize)
    step = max(1, BLOCK_BYTES // row)
    if dataset.chunks:
        step = max(dataset.chunks[0], step // dataset.chunks[0] * dataset.chunks[0])
    for start in range(0, dataset.shape[0], step):
        yield dataset[start : start + step]
