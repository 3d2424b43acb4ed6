"""Scan plan in the protocol's units: points and sampling."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabry_perot.wire.constants import FLAG_GATE, MAX_GROUP
from fabry_perot.wire.framing import crc32c
from fabry_perot.wire.messages import PLAN_HEAD, POINT


@dataclass(frozen=True, eq=False)
class WirePlan:
    """Scan plan in protocol units.

    Parameters
    ----------
    points
        (M,) records of :data:`fabry_perot.wire.messages.POINT`.
    samples
        Samples per A-line.
    interval_ps
        Sampling interval in ps.
    pulse_rate_mhz
        Pulse rate in mHz.
    encoding
        How A-lines travel; no part of the plan's identity.
    tag
        Part of the identity and of nothing else: tells uploads of the same points apart.
    beams
        Points come as many at a time as there are beams, all of them where the first beam goes.
    """

    points: NDArray[np.void]
    samples: int
    interval_ps: int
    pulse_rate_mhz: int
    encoding: int = 0
    tag: int = 0
    beams: int = 1

    @classmethod
    def from_metres(
        cls,
        points: NDArray[np.float64],
        *,
        samples: int,
        sampling_interval: float,
        pulse_rate: float,
        averages: int = 1,
        wavelength: float | NDArray[np.float64] = 0.0,
        gated: bool | NDArray[np.bool_] = False,
        encoding: int = 0,
        tag: int = 0,
        beams: int = 1,
    ) -> WirePlan:
        """Create the plan for (M, 2) positions in m; the rest in SI units, ``wavelength``, ``gated`` one or (M,)."""
        records = np.zeros(len(points), POINT)
        records["x"], records["y"] = np.rint(points.T * 1e9)
        records["averages"] = averages
        records["wavelength"] = np.rint(np.asarray(wavelength) * 1e12)
        records["flags"] = np.where(gated, FLAG_GATE, 0)
        interval, rate = round(sampling_interval * 1e12), round(pulse_rate * 1e3)
        return cls(np.repeat(records, beams), samples, interval, rate, encoding, tag, beams)

    @cached_property
    def uid(self) -> int:
        """Checksum that identifies the plan's content (u32, never 0): equal plans have equal uids."""
        tag = f",{self.tag}" if self.tag else ""
        tag += f",beams {self.beams}" if self.beams > 1 else ""
        head = f"{self.samples},{self.interval_ps},{self.pulse_rate_mhz}{tag};".encode()
        return crc32c(head + self.points.tobytes()) or 1

    @property
    def length(self) -> int:
        """Number of points, and therefore of A-lines."""
        return len(self.points)

    @cached_property
    def shots(self) -> NDArray[np.int64]:
        """Shots (M,) for each point; 0 for further beams at the same place, which share its shots."""
        shots = np.maximum(1, self.points["averages"].astype(np.int64))
        shots[np.arange(self.length) % self.beams > 0] = 0
        return shots

    def places(self, first: int, stop: int) -> int:
        """Return the number of places for the points from ``first`` to below ``stop``."""
        return -(-stop // self.beams) - first // self.beams if stop > first else 0

    def request(self, *, purge: bool, start: int = 0) -> dict[str, Any]:
        """Return the body of PLAN_NEW for the points from ``start``; ``purge`` discards A-lines of another plan."""
        return {
            "plan": self.uid,
            "length": self.length,
            "samples": self.samples,
            "interval_ps": self.interval_ps,
            "pulse_rate_mhz": self.pulse_rate_mhz,
            "purge": purge,
            "start": start,
            "encoding": self.encoding,
            "group": MAX_GROUP,
            **({"beams": self.beams} if self.beams > 1 else {}),
        }

    def data(self, first: int, limit: int, payload: int) -> bytes:
        """Return one PLAN_DATA payload of points from ``first``, below ``limit`` and within ``payload`` bytes."""
        count = min(limit - first, (payload - PLAN_HEAD.size) // POINT.itemsize)
        return PLAN_HEAD.pack(self.uid, first, count) + self.points[first : first + count].tobytes()
