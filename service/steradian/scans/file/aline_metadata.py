"""Per-A-line metadata table and its row checksums.

One CRC-32C (Castagnoli) covers the row's samples and then its columns in the order of :data:`schema.ROW`, packed,
little-endian. The samples' own checksum comes with them from the scanner; it is only continued over the columns, some
50 bytes. In files before version 3 the checksum covers the samples alone.
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
    version
        Of the file.
    columns
        (n,) each, by the names of :data:`schema.COLUMNS`; what the file's version lacks is what its plan says.
    """

    version: int
    columns: dict[str, NDArray[Any]]

    @classmethod
    def of_file(cls, file: h5py.File, rows: slice = slice(None)) -> Self:
        """Read the metadata columns of ``rows`` from an open scan file.

        While the file is written ``status`` is read first, as it is written last. Raises KeyError where one is missing.
        """
        alines, version, plan = file["alines"], int(file.attrs["schema_version"]), file["plan"].attrs
        kinds = schema.columns_of(version)
        columns = {name: np.asarray(alines[name][rows], kind) for name, kind in reversed(kinds.items())}
        return cls.of_columns(version, columns, int(plan["averages"]), float(plan["time_zero_s"]))

    @classmethod
    def of_columns(cls, version: int, columns: Mapping[str, NDArray[Any]], averages: int, time_zero: float) -> Self:
        """Create a table from columns; columns missing in earlier file versions get the plan's values."""
        usual = {"averages": averages, "time_zero_s": time_zero}
        lacking = {
            name: np.full(len(columns["status"]), usual.get(name, 0), kind)
            for name, kind in schema.COLUMNS.items()
            if name not in columns
        }
        return cls(version, {**columns, **lacking})

    @classmethod
    def joined(cls, tables: Sequence[ShotTable]) -> Self:
        """Concatenate tables of one file."""
        names = tables[0].columns
        return cls(tables[0].version, {name: np.concatenate([each[name] for each in tables]) for name in names})

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return the values (n,) of a column by name."""
        return self.columns[name]

    @property
    def stored(self) -> NDArray[np.bool_]:
        """Boolean array (n,): rows with the status *stored*."""
        stored: NDArray[np.bool_] = self.columns["status"] == schema.STORED
        return stored

    @property
    def checksums_cover_columns(self) -> bool:
        """Whether the row checksums of this file version cover the metadata columns."""
        return self.version >= schema.ROW_CHECKSUM_SINCE

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_] | slice) -> ShotTable:
        """Return a table of a subset of the rows."""
        return ShotTable(self.version, {name: values[index] for name, values in self.columns.items()})

    def verify_rows(self, samples: NDArray[Any]) -> NDArray[np.bool_]:
        """Return a boolean array (n,): rows that, with their samples (n, N_t), match their checksum."""
        if not len(samples):
            return np.zeros(0, np.bool_)
        checksums = [google_crc32c.value(row.tobytes()) for row in samples]
        proven: NDArray[np.bool_] = (
            row_checksums(self.version, checksums, pack_rows(self.columns)) == self.columns["crc32c"]
        )
        return proven


def pack_rows(columns: Mapping[str, Any]) -> NDArray[np.void]:
    """Pack columns into structured rows of dtype :data:`schema.ROW` with status stored and without checksums."""
    packed = np.zeros(len(columns["shot"]), schema.ROW)
    for name in schema.COLUMNS:
        if name not in ("crc32c", "status"):
            packed[name] = columns[name]
    packed["status"] = schema.STORED
    return packed


def row_checksums(
    version: int, samples: Sequence[int] | NDArray[np.uint32], packed: NDArray[np.void]
) -> NDArray[np.uint32]:
    """Return the checksums (n,) of rows from the checksums of their samples and their packed columns."""
    if version < schema.ROW_CHECKSUM_SINCE:
        return np.asarray(samples, np.uint32)
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
