"""Averaging of a point's shots into its A-line."""

from __future__ import annotations

import numpy as np

from fabry_perot.hardware.components import TriggerRecord
from fabry_perot.hardware.instrument import PointRecord
from fabry_perot.wire.constants import MISFIRE

MISSING_ENERGY = (0, 1 << 31)
"""Where a laser says no range."""


def average_shots(point: int, records: list[TriggerRecord], energies: tuple[int, int] = MISSING_ENERGY) -> PointRecord:
    """Return the mean A-line of ``point`` from one beam's records of its shots; quality bits are combined.

    So does a pulse energy out of range, as a misfire: in the mean it may not show.
    """
    last, count = records[-1], len(records)
    samples = records[0].samples
    if count > 1 or samples.dtype != np.int16:
        total = np.sum([record.samples for record in records], axis=0, dtype=np.float64)
        samples = np.clip(np.rint(total / count), -32768, 32767).astype(np.int16)
    quality = 0
    for record in records:
        quality |= record.quality
        quality |= 0 if energies[0] <= record.energy <= energies[1] else MISFIRE
    return PointRecord(
        samples=samples.astype(np.int16, copy=False),
        scale=last.scale,
        point=point,
        fire_time=last.time,
        shot=last.shot,
        averages=count,
        energy=round(sum(record.energy for record in records) / count),
        wavelength=last.wavelength,
        dc=round(sum(record.dc for record in records) / count),
        quality=quality,
        time_zero=last.time_zero,
        gain=last.gain,
        beam=last.beam,
    )
