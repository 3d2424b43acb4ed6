"""Allowed ranges of physical quantities in SI units.

They are wide, and yet no usual number in nanoseconds, hertz or millimetres a microsecond falls into one of them, and of
lengths in millimetres or micrometres only those of at most 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from steradian.core.exceptions import InvalidInput


@dataclass(frozen=True, slots=True)
class QuantityRange:
    """Range of a quantity from ``low`` (exclusive if ``above``) to ``high``, in ``unit``."""

    low: float
    high: float
    unit: str
    above: bool = False

    @property
    def limits(self) -> dict[str, float]:
        """Bounds of the range as pydantic field constraints (gt or ge, and le)."""
        return {"gt" if self.above else "ge": self.low, "le": self.high}

    def __contains__(self, number: float) -> bool:
        return bool((self.low < number if self.above else self.low <= number) and number <= self.high)

    def __str__(self) -> str:
        return f"{'>' if self.above else 'at least'} {self.low:g}, at most {self.high:g} ({self.unit})"

    def check(self, field: str, value: object) -> float:
        """Validate that ``value`` is a finite number in the range and return it as a float.

        Raises
        ------
        InvalidInput
            If it is none, or out of range.
        """
        number = as_finite_float(field, value, str(self))
        if number not in self:
            raise InvalidInput(field, value, str(self))
        return number

    def check_integer(self, field: str, value: object) -> int:
        """Validate that ``value`` is a whole number in the range and return it as an integer.

        Raises
        ------
        InvalidInput
            If it is not a whole number, or out of range.
        """
        allowed = f"a whole number from {self.low:,.0f} to {self.high:,.0f}"
        number = as_finite_float(field, value, allowed)
        if number != int(number) or number not in self:
            raise InvalidInput(field, value, allowed)
        return int(number)


LENGTH = QuantityRange(0, 1, "m", above=True)
"""Sides of apertures, distances between sensors, depths of points of interest."""
SAMPLING_INTERVAL = QuantityRange(1e-10, 1e-5, "s")
SOUND_SPEED = QuantityRange(300, 6000, "m/s")
SEARCHED_SPEEDS = QuantityRange(1380, 1620, "m/s")
"""Speeds of sound among which one is searched, unless others are given."""
LAYER_SPEED = QuantityRange(300, 12_000, "m/s")
"""Speed of sound in a layer, which may be a metal."""
LAYER_THICKNESS = QuantityRange(1e-6, 1, "m")
"""Thickness of a layer of the medium."""
SEARCH_SPAN = QuantityRange(0.001, 0.5, "of the start value")
"""Half-width of the range searched for a parameter of the medium, relative to its start value."""
DENSITY = QuantityRange(100, 25_000, "kg/m³")
SPOT = QuantityRange(1e-7, 5e-3, "m")
"""Diameter of an interrogation beam."""
ATTENUATION = QuantityRange(0, 100, "dB/(MHz^y cm)")
"""Coefficient of a power law of acoustic attenuation."""
ATTENUATION_POWER = QuantityRange(0, 2.9, "power of the frequency")
TIME_ZERO = QuantityRange(-5e-4, 5e-4, "s")
"""From the laser pulse to the first sample: sound from three quarters of a metre of water needs no longer."""


TOLERANCE = QuantityRange(1e-12, 0.1, "relative")
"""Relative l2 error of the transforms."""
MODES = QuantityRange(2, 4096, "modes")
"""Lateral modes per axis."""
UPSAMPLING = QuantityRange(1, 16, "times")
"""Image points per mode."""
PADDING = QuantityRange(1, 16, "times")
"""Factors by which record and aperture are extended with zeros."""
GAIN = QuantityRange(1, 10_000, "times")
"""Largest amplification of a film correction."""
SAMPLES = QuantityRange(4, 1 << 24, "samples")
"""Samples of an A-line that a reconstruction takes."""
THREADS = QuantityRange(1, 1024, "threads")


def as_finite_float(field: str, value: Any, allowed: str) -> float:
    """Validate that ``value`` is a finite number and return it as a float.

    Raises
    ------
    InvalidInput
        If it is a text, even of a number, or anything else but one finite number.
    """
    try:
        if isinstance(value, str | bytes) or np.ndim(value):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError):
        raise InvalidInput(field, repr(value), allowed) from None
    if not np.isfinite(number):
        raise InvalidInput(field, value, allowed)
    return number
