"""A-lines and batches of A-lines.

On its way through the driver an A-line is a *record*: the meta and the samples as little-endian int16, which is what
arrives when it was sent plainly and whole. It is unpacked when somebody looks at it.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, overload

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from fabry_perot.errors import FrameError
from fabry_perot.wire.encoding import Encoding, decode
from fabry_perot.wire.framing import crc32c
from fabry_perot.wire.messages import LAYOUT, ALineMeta

_META = LAYOUT[ALineMeta]
META_SIZE = _META.size
_PEEK = struct.Struct("<16xI8xH")
"""Checksum and number of samples in a record."""
_peek, _value = _PEEK.unpack_from, google_crc32c.value


def is_complete(record: bytes, size: int) -> bool:
    """Return whether a record of ``size`` ≥ :data:`META_SIZE` bytes is complete and matches its checksum."""
    crc, count = _peek(record)
    return META_SIZE + 2 * count == size and _value(record[META_SIZE:]) == crc  # type: ignore[no-any-return]


def parse_record(blob: bytes, encoding: int = Encoding.INT16) -> bytes:
    """Decode an A-line's blob (meta ‖ encoded samples) into a record with decoded samples.

    Raises
    ------
    FrameError
        Length or checksum of the samples are wrong, or the encoding is unknown.
    """
    if len(blob) < META_SIZE:
        raise FrameError(f"{len(blob)} bytes where an A-line has at least {META_SIZE}")
    crc, count = _PEEK.unpack_from(blob)
    data = blob[META_SIZE:]
    if encoding != Encoding.INT16:
        data = decode(data, encoding, count).astype("<i2", copy=False).tobytes()
        blob = blob[:META_SIZE] + data
    if len(data) != 2 * count:
        raise FrameError(f"{len(data)} bytes for {count} samples")
    if crc32c(data) != crc:
        raise FrameError("samples do not match their checksum")
    return blob


@dataclass(frozen=True, slots=True, eq=False)
class ALine:
    """Recorded pressure trace (A-line) of one detection point, with its metadata.

    Parameters
    ----------
    number
        Position in the plan's sequence of A-lines, from 0.
    point
        Index into the uploaded points.
    samples
        (N_t,) int16 counts.
    scale
        Pressure unit per count.
    sampling_interval
        Seconds between samples.
    fire_time_s
        Device time of the (last) shot, in s since the device's boot.
    shot
        Number of that shot since boot.
    averages
        Shots averaged.
    energy
        Mean pulse energy relative to nominal.
    wavelength_m
        Interrogation wavelength, in m.
    time_zero_offset_s
        Time of the first sample after the pulse, in s.
    dc_v
        DC level of the interferometer signal, in V.
    gain_db
        Gain of the receiver, in dB over its usual one; ``scale`` has taken it into account.
    quality
        Flags: 1 saturated, 2 mistuned, 4 misfire, 8 partial average.
    """

    number: int
    point: int
    samples: NDArray[np.int16]
    scale: float
    sampling_interval: float
    fire_time_s: float
    shot: int
    averages: int
    energy: float
    wavelength_m: float
    time_zero_offset_s: float
    dc_v: float
    gain_db: float
    quality: int

    @classmethod
    def from_record(cls, number: int, point: int, record: bytes) -> ALine:
        """Create the A-line from a checked record."""
        meta = ALineMeta(*_META.unpack_from(record))
        return cls(
            number,
            point,
            np.frombuffer(record, "<i2", offset=META_SIZE).astype(np.int16, copy=False),
            meta.scale,
            meta.interval * 1e-12,
            meta.fire_time * 1e-6,
            meta.shot,
            meta.averages,
            meta.energy * 1e-4,
            meta.wavelength * 1e-12,
            meta.time_zero * 1e-10,
            meta.dc * 1e-3,
            meta.gain * 1e-2,
            meta.quality,
        )


_FIELDS = {
    "scale": ("scale", 1.0),
    "sampling_interval": ("interval", 1e-12),
    "fire_time_s": ("fire_time", 1e-6),
    "shot": ("shot", 1),
    "averages": ("averages", 1),
    "energy": ("energy", 1e-4),
    "wavelength_m": ("wavelength", 1e-12),
    "time_zero_offset_s": ("time_zero", 1e-10),
    "dc_v": ("dc", 1e-3),
    "gain_db": ("gain", 1e-2),
    "quality": ("quality", 1),
    "crc32c": ("crc", 1),
}
"""Attributes of an A-line that are numbers, and its samples' checksum: field of the record and its unit."""


META = np.dtype(
    list(
        zip(
            "fire_time wavelength shot crc scale interval count averages energy dc gain quality pad time_zero".split(),
            "<u8 <u4 <u4 <u4 <f4 <u4 <u2 <u2 <u2 <i2 <i2 u1 u1 <i4".split(),
            strict=True,
        )
    )
)
"""Structure of a record's meta, in the protocol's units."""


class ALineBatch(Sequence[ALine]):
    """Batch of A-lines of equal length, in order of number: a sequence of :class:`ALine`, also readable as columns.

    An :class:`ALine` is made when it is looked at. Columns cost nothing per A-line, so that is how to store many.

    Parameters
    ----------
    first
        Number of the first one; the others follow it.
    points
        Their points.
    records
        Their checked records, all of the same length.
    """

    __slots__ = ("_meta", "_points", "_records", "first")

    def __init__(self, first: int = 0, points: Sequence[int] = (), records: Sequence[bytes] = ()) -> None:
        self.first = first
        self._points, self._records = points, records
        self._meta: NDArray[np.void] | None = None

    def __len__(self) -> int:
        return len(self._records)

    @overload
    def __getitem__(self, index: int) -> ALine: ...
    @overload
    def __getitem__(self, index: slice) -> list[ALine]: ...
    def __getitem__(self, index: int | slice) -> ALine | list[ALine]:
        if isinstance(index, slice):
            return [self[place] for place in range(*index.indices(len(self)))]
        place = range(len(self))[index]
        return ALine.from_record(self.first + place, self._points[place], self._records[place])

    @property
    def meta(self) -> NDArray[np.void]:
        """Metadata (n,) of the A-lines, of structure :data:`META`, read-only."""
        if self._meta is None:
            self._meta = np.frombuffer(b"".join([record[:META_SIZE] for record in self._records]), META)
        return self._meta

    @property
    def sample_bytes(self) -> list[bytes]:
        """Samples of each A-line as little-endian int16 bytes."""
        return [record[META_SIZE:] for record in self._records]

    @property
    def samples(self) -> NDArray[np.int16]:
        """Samples (n, N_t) as int16 counts, read-only."""
        data = np.frombuffer(b"".join(self.sample_bytes), "<i2")
        return data.reshape(len(self), -1 if len(self) else 0).astype(np.int16, copy=False)

    def column(self, name: str) -> NDArray[Any]:
        """Return (n,) values of an attribute of :class:`ALine`, in its unit; (n, N_t) for ``samples``.

        Raises
        ------
        KeyError
            An A-line has no such attribute.
        """
        if name == "samples":
            return self.samples
        if name == "number":
            return np.arange(self.first, self.first + len(self))
        if name == "point":
            return np.array(self._points, np.int64)
        field, unit = _FIELDS[name]
        values = self.meta[field]
        return values if unit == 1 else values * unit
