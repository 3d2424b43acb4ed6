"""The A-line: what one interrogation of one point recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
    def from_blob(cls, number: int, point: int, blob: bytes) -> ALine:
        """Return the A-line in ``blob`` (meta ‖ int16 samples).

        Raises
        ------
        FrameError
            Length or checksum of the samples are wrong.
        """
        meta = unpack(ALineMeta, blob, tail=True)
        data = blob[_META:]
        if len(data) != 2 * meta.samples or crc32c(data) != meta.crc:
            raise FrameError(f"A-line {number}: samples do not match their length or checksum")
        return cls(
            number=number,
            point=point,
            samples=np.frombuffer(data, "<i2").astype(np.int16, copy=False),
            scale=meta.scale,
            sampling_interval=meta.interval * 1e-12,
            fire_time_s=meta.fire_time * 1e-6,
            shot=meta.shot,
            averages=meta.averages,
            energy=meta.energy * 1e-4,
            wavelength_m=meta.wavelength * 1e-12,
            time_zero_offset_s=meta.time_zero * 1e-10,
            dc_v=meta.dc * 1e-3,
            quality=meta.quality,
        )
