"""Parser of .sgl file names, which contain acquisition settings.

``NAME@750nm_t0[0]_dx[100µm]_dy[100µm]_dt[8ns]_03s08m21h_04-12-18_avg1_2D_raw.SGL``: excitation wavelength, time of the
first sample in samples after the pulse, steps, sampling interval, averages.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

NUMBER = r"(-?\d{1,7}(?:\.\d{1,7})?)"
EXCITATION = re.compile(rf"@{NUMBER}nm", re.IGNORECASE)
TIME_ZERO = re.compile(r"(?:^|_)t0?\[(-?\d{1,7})\]", re.IGNORECASE)
"""Both spellings are in use: ``t0[0]`` and ``t[0]``."""
AVERAGES = re.compile(r"_avg(\d{1,6})(?![0-9])", re.IGNORECASE)
TWO_PLANES = re.compile(r"v[-_ ]?shape|two[-_ ]?planes?|2[-_ ]?planes", re.IGNORECASE)
PATTERNS = re.compile(r"hadamard", re.IGNORECASE)
LENGTHS = {"": 1.0, "m": 1e-3, "n": 1e-9}
TIMES = {"": 1.0, "m": 1e-3, "n": 1e-9, "p": 1e-12}
"""SI prefixes; any other one is micro, whose sign has several encodings."""


@dataclass(frozen=True)
class Figure:
    """Number parsed from a file name: value in SI units and rounding error."""

    value: float
    rounding: float

    def agrees(self, other: float) -> bool:
        """Return whether another number equals this one within the rounding error."""
        return abs(other - self.value) <= self.rounding * 1.01 + 1e-6 * abs(self.value)


@dataclass(frozen=True)
class SglNameMetadata:
    """Metadata parsed from the name of an .sgl file; ``None`` for fields that the name does not contain.

    Attributes
    ----------
    excitation, dx, dy, dt
        Metres, metres, metres, seconds.
    time_zero
        First sample, in samples after the pulse.
    averages
        Pulses averaged into an A-line.
    two_planes, patterns
        Whether the name speaks of a two-plane (V-shape) scanner, or of Hadamard patterns.
    """

    excitation: Figure | None
    dx: Figure | None
    dy: Figure | None
    dt: Figure | None
    time_zero: int | None
    averages: int | None
    two_planes: bool
    patterns: bool


def read_name(name: str) -> SglNameMetadata:
    """Parse the metadata in the name of an .sgl file."""
    excitation, start, averages = (rule.search(name) for rule in (EXCITATION, TIME_ZERO, AVERAGES))
    return SglNameMetadata(
        excitation=_figure(excitation[1], 1e-9) if excitation else None,
        dx=_quantity(name, "dx", "m", LENGTHS),
        dy=_quantity(name, "dy", "m", LENGTHS),
        dt=_quantity(name, "dt", "s", TIMES),
        time_zero=int(start[1]) if start else None,
        averages=int(averages[1]) if averages else None,
        two_planes=TWO_PLANES.search(name) is not None,
        patterns=PATTERNS.search(name) is not None,
    )


def _quantity(name: str, label: str, unit: str, prefixes: dict[str, float]) -> Figure | None:
    found = re.search(rf"{label}\[{NUMBER}\s*([^\]]{{0,4}}?){unit}\]", name, re.IGNORECASE)
    return None if found is None else _figure(found[1], prefixes.get(found[2], 1e-6))


def _figure(text: str, unit: float) -> Figure:
    decimals = len(text.partition(".")[2])
    scale = round(1 / unit)
    return Figure(float(text) / scale, 0.5 / 10**decimals / scale)
