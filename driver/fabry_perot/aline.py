"""The A-line: what one interrogation of one point recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabry_perot.encoding import Encoding, decode
from fabry_perot.errors import FrameError
from fabry_perot.framing import crc32c
from fabry_perot.messages import LAYOUT, ALineMeta, unpack

_META = LAYOUT[ALineMeta].size


@dataclass(frozen=True, slots=True, eq=False)
class ALine:
    """One recorded pressure trace.

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
    quality: int

    @classmethod
    def from_blob(cls, number: int, point: int, blob: bytes, encoding: int = 0) -> ALine:
        """Return the A-line in ``blob`` (meta ‖ encoded samples).

        Raises
        ------
        FrameError
            Length or checksum of the samples are wrong.
        """
        meta = unpack(ALineMeta, blob, tail=True)
        data = blob[_META:]
        samples = decode(data, encoding, meta.samples)
        if crc32c(data if encoding == Encoding.INT16 else samples.astype("<i2", copy=False).tobytes()) != meta.crc:
            raise FrameError(f"A-line {number}: samples do not match their checksum")
        return cls(
            number,
            point,
            samples,
            meta.scale,
            meta.interval * 1e-12,
            meta.fire_time * 1e-6,
            meta.shot,
            meta.averages,
            meta.energy * 1e-4,
            meta.wavelength * 1e-12,
            meta.time_zero * 1e-10,
            meta.dc * 1e-3,
            meta.quality,
        )
