"""Digitiser component for a card that stores one record per trigger, with its time, in a ring buffer.

``card`` has what cards for multiple records have under many names: ``setup``, ``start``, ``available``, ``read``,
``stop``, ``clock`` and ``mean``; ``bench.cards.DigitiserCard`` is one that is made up.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabry_perot import TuningMap
from fabry_perot.hardware import PlanSampling, TriggerRecord

QUANTUM = 1e-10
"""Unit of a record's time zero in s."""
SATURATED = 1


class RingDigitiser:
    """:class:`~fabry_perot.hardware.Digitiser` on a card with a ring buffer of records.

    Parameters
    ----------
    card
        The card.
    places
        Tells where each trigger of the block found the beam, (T, 2) in nm, and at which wavelength, in pm.
    film
        Map of the film: its slope (V/m) at a place makes the pressure unit of a count. None: the same everywhere.
    metres_per_pascal
        Shift of the film's resonance with pressure.
    delay
        Time of the first sample after the laser pulse, in s (``fabry_perot.hardware.time_zero``).
    """

    def __init__(
        self,
        card: Any,
        places: Callable[[], tuple[NDArray[np.int64], int]],
        *,
        film: TuningMap | None = None,
        metres_per_pascal: float = 1e-15,
        delay: float = 0.0,
    ) -> None:
        self._card, self._places, self._film = card, places, film
        self._shift, self._delay = metres_per_pascal, round(delay / QUANTUM)
        self._offset = self._taken = 0

    def limits(self) -> dict[str, Any]:
        """Return the ranges of record length and sampling interval, and the ADC resolution."""
        return {"samples": [16, 8192], "interval_ps": [4_000, 1_000_000], "adc_bits": 14}

    def begin(self, sampling: PlanSampling) -> None:
        """Set number of samples and sampling interval of records."""
        self._card.setup(sampling.samples, 1e-12 * sampling.interval_ps)

    def arm(self, records: int, now: int) -> None:
        """Start recording of ``records`` triggers, and measure the offset between the card's and the device's clock."""
        self._taken = 0
        self._offset = now - self._card.clock()
        self._card.start(records)

    def records(self, now: int) -> list[TriggerRecord]:
        """Return the finished records from the card's ring buffer."""
        counts, times, numbers = self._card.read(self._card.available())
        where, wavelength = self._places()
        made = []
        for row, time, number in zip(counts, times.tolist(), numbers.tolist(), strict=True):
            level = round(1e3 * self._card.mean())
            saturated = int(np.abs(row).max()) >= self._card.full_scale
            made.append(
                TriggerRecord(
                    samples=row,
                    scale=self._pascals(where[self._taken]),
                    time=time + self._offset,
                    shot=number,
                    wavelength=wavelength,
                    dc=level,
                    quality=SATURATED if saturated else 0,
                    time_zero=self._delay,
                )
            )
            self._taken += 1
        return made

    def disarm(self) -> None:
        """Stop the card and clear its ring buffer."""
        self._card.stop()

    def level(self, now: int) -> int:
        """Return the DC level of the reflected light in mV."""
        return round(1e3 * self._card.mean())

    def _pascals(self, place: NDArray[np.int64]) -> float:
        """Return the pressure (Pa) of one count at a position, from film slope and resonance shift per pascal."""
        slope = 2e9
        if self._film is not None:
            slope = float(self._film.sensitivity[np.argmin(np.hypot(*(self._film.points - 1e-9 * place).T))])
        return float(self._card.volts_per_count) / (slope * self._shift)
