"""Depth extent of a record: first and last depth of the image, and the minimum period along depth.

A sample at the time t after the pulse tells of depths from 0 (waves along the film) to c·t (waves straight up). So a
record of N_t samples from t₀ on tells of depths up to c·(t₀ + N_t·dt), and an image with a shorter period along the
depth folds some of them onto others.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import Self

from steradian.core.exceptions import InvalidInput

LATE = 0.25
"""Share of its own length after the pulse from which on a record counts as late: its image then begins at c·t₀."""


@dataclass(frozen=True, slots=True)
class Extent:
    """Time range of a record in samples, equal to the depth range in slices c·dt apart.

    Parameters
    ----------
    samples
        N_t.
    begins
        t₀/dt, samples from the laser pulse to the first of the record; negative where the record begins earlier.
    """

    samples: int
    begins: float

    @classmethod
    def of(cls, samples: int, sampling_interval: float, time_zero: float) -> Self:
        """Return the extent of a record with times in seconds.

        Raises
        ------
        InvalidInput
            If the record ends before the laser pulse.
        """
        found = cls(samples, round(time_zero / sampling_interval, 6))
        if found.end < 2:
            least = -(samples - 2) * sampling_interval
            allowed = f"at least {least:.4g} (s): this record of {samples} samples must go on after the laser pulse"
            raise InvalidInput("t0", time_zero, allowed)
        return found

    @property
    def late(self) -> bool:
        """Whether the record begins so late that the default image does not include the film's surface."""
        return self.begins > LATE * self.samples

    @property
    def ahead(self) -> int:
        """Samples from the laser pulse to the record, rounded up; 0 if the record begins before the pulse."""
        return max(0, ceil(self.begins))

    @property
    def first(self) -> int:
        """First slice of the default image: 0, or that of t₀ if the record is late."""
        return self.ahead if self.late else 0

    @property
    def end(self) -> int:
        """Index after the deepest slice covered by the record."""
        return self.samples + ceil(self.begins)
