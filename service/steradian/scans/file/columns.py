"""Conversion of A-lines to column arrays for storage."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from fabry_perot import ALineBatch
from steradian.core.exceptions import InvalidInput
from steradian.scans.file import schema

METADATA_COLUMNS = tuple(name for name in schema.COLUMNS if name not in ("crc32c", "status"))
"""Columns that come with the A-lines."""
ATTRIBUTE_BY_COLUMN = {name: name for name in METADATA_COLUMNS} | {"time_zero_s": "time_zero_offset_s"}
"""What an A-line calls them."""


class AlineLike(Protocol):
    """Protocol of an A-line accepted by the scan file writer (``fabry_perot.ALine`` satisfies it).

    ``point`` counts in visit order.
    """

    @property
    def point(self) -> int: ...  # noqa: D102
    @property
    def samples(self) -> NDArray[np.int16] | NDArray[np.float32]: ...  # noqa: D102
    @property
    def scale(self) -> float: ...  # noqa: D102
    @property
    def energy(self) -> float: ...  # noqa: D102
    @property
    def wavelength_m(self) -> float: ...  # noqa: D102
    @property
    def fire_time_s(self) -> float: ...  # noqa: D102
    @property
    def quality(self) -> int: ...  # noqa: D102
    @property
    def shot(self) -> int: ...  # noqa: D102
    @property
    def averages(self) -> int: ...  # noqa: D102
    @property
    def time_zero_offset_s(self) -> float: ...  # noqa: D102
    @property
    def dc_v(self) -> float: ...  # noqa: D102
    @property
    def gain_db(self) -> float: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class AlineColumns:
    """A-lines as column arrays: point numbers, sample bytes, checksums and metadata.

    Attributes
    ----------
    points
        (n,) what the scanner calls them.
    pieces
        The bytes of each one's samples.
    checksums
        CRC-32C of these; the scanner's own where it came with them.
    values
        The columns of :data:`METADATA_COLUMNS`, (n,) each.
    """

    points: NDArray[np.int64]
    pieces: list[bytes]
    checksums: NDArray[np.uint32] | list[int]
    values: Mapping[str, NDArray[Any] | list[Any]]


def to_columns(alines: Iterable[AlineLike], samples: int, kind: np.dtype[Any]) -> AlineColumns:
    """Convert A-lines of ``samples`` samples to column arrays; raises :class:`InvalidInput` for invalid ones.

    What comes as a batch of the driver's has its columns, and checksums that were made in the scanner, already.
    """
    if isinstance(alines, ALineBatch) and kind == schema.SAMPLES:
        pieces = alines.sample_bytes
        if pieces and len(pieces[0]) != samples * kind.itemsize:
            raise InvalidInput("samples", f"A-lines of {len(pieces[0]) // kind.itemsize} samples", f"{samples} samples")
        values: dict[str, Any] = {name: alines.column(ATTRIBUTE_BY_COLUMN[name]) for name in METADATA_COLUMNS}
        return AlineColumns(alines.column("point"), pieces, alines.column("crc32c"), values)
    each = list(alines)
    for aline in each:
        if aline.samples.shape != (samples,):
            raise InvalidInput("samples", f"an A-line of shape {aline.samples.shape}", f"({samples},)")
    pieces = [np.ascontiguousarray(aline.samples, kind).tobytes() for aline in each]
    checksums = [google_crc32c.value(piece) for piece in pieces]
    points = np.array([aline.point for aline in each], np.int64)
    table = {name: [getattr(aline, ATTRIBUTE_BY_COLUMN[name]) for aline in each] for name in METADATA_COLUMNS}
    return AlineColumns(points, pieces, checksums, table)
