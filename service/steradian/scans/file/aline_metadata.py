"""Per-A-line metadata table and its row checksums.

One CRC-32C (Castagnoli) covers the row's samples and then its columns in the order of :data:`schema.ROW`, packed,
little-endian. The samples' own checksum comes with them from the scanner; it is only continued over the columns, some
50 bytes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from steradian.scans.file import schema

if TYPE_CHECKING:
    import h5py


@dataclass(frozen=True, eq=False)
class ShotTable:
    """Table of per-A-line metadata (columns) of rows of a scan file.

    Attributes
    ----------
    columns
        (n,) each, by the names of :data:`schema.COLUMNS`.
    """

    columns: dict[str, NDArray[Any]]

    @classmethod
    def of_file(cls, file: h5py.File, rows: slice = slice(None)) -> Self:
        """Read the metadata columns of ``rows`` from an open scan file.

        While the file is written ``status`` is read first, as it is written last. Raises KeyError where one is missing.
        """
        alines = file["alines"]
        return cls({name: np.asarray(alines[name][rows], kind) for name, kind in reversed(schema.COLUMNS.items())})

    @classmethod
    def joined(cls, tables: Sequence[ShotTable]) -> Self:
        """Concatenate tables of one file."""
        names = tables[0].columns
        return cls({name: np.concatenate([each[name] for each in tables]) for name in names})

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return the values (n,) of a column by name."""
        return self.columns[name]

    @property
    def stored(self) -> NDArray[np.bool_]:
        """Boolean array (n,): rows with the status *stored*."""
        stored: NDArray[np.bool_] = self.columns["status"] == schema.STORED
        return stored

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_] | slice) -> ShotTable:
        """Return a table of a subset of the rows."""
        return ShotTable({name: values[index] for name, values in self.columns.items()})

    def verify_rows(self, samples: NDArray[Any]) -> NDArray[np.bool_]:
        """Return a boolean array (n,): rows that, with their samples (n, N_t), match their checksum."""
        if not len(samples):
            return np.zeros(0, np.bool_)
        checksums = [google_crc32c.value(row.tobytes()) for row in samples]
        proven: NDArray[np.bool_] = row_checksums(checksums, pack_rows(self.columns)) == self.columns["crc32c"]
        return proven


def pack_rows(columns: Mapping[str, Any]) -> NDArray[np.void]:
    """Pack columns into structured rows of dtype :data:`schema.ROW` with status stored and without checksums."""
    packed = np.zeros(len(columns["shot"]), schema.ROW)
    for name in schema.COLUMNS:
        if name not in ("crc32c", "status"):
            packed[name] = columns[name]
    packed["status"] = schema.STORED
    return packed


def row_checksums(samples: Sequence[int] | NDArray[np.uint32], packed: NDArray[np.void]) -> NDArray[np.uint32]:
    """Return the checksums (n,) of rows from the checksums of their samples and their packed columns."""
    data, size, extend = packed.tobytes(), packed.itemsize, google_crc32c.extend
    starts = range(0, len(data), size)
    checksums = samples.tolist() if isinstance(samples, np.ndarray) else samples
    return np.array(
        [
            extend(crc, data[start + schema.FILE_FORMAT_MARKER : start + size])
            for crc, start in zip(checksums, starts, strict=True)
        ],
        np.uint32,
    )
