"""Capabilities reported by a scanner, and the validation of a plan against them.

The device sends one CBOR map. Ranges are ``[lowest, highest]``:

- ``model``, ``serial``: text; ``simulated``: bool
- ``x_nm``, ``y_nm``, ``samples``, ``interval_ps``, ``pulse_rate_mhz``, ``averages``, ``wavelength_pm``: ranges
- ``adc_bits``, ``beams``: integers; ``encodings``: list of integers
- ``beam_offsets_nm``: [x, y] of each beam beside the first one, where there are several
- ``clock_rate``: device seconds per host second, 1 on hardware
- ``line_rate``: bytes per second the line carries, 0 when nothing paces it
- ``lease_cap_us``: longest lease granted, in µs
- ``tuning_us``: time one step of TUNE_SCAN takes; ``parameters``: map of what SET changes to its range; both optional
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fabry_perot.errors import FrameError, PlanInvalid
from fabry_perot.wire.encoding import NAMES, Encoding
from fabry_perot.wire.framing import encoded_size

Range = tuple[float, float]
_ALINE_OVERHEAD = 56


@dataclass(frozen=True, slots=True)
class Capabilities:
    """Limits and identity of a scanner.

    Parameters
    ----------
    model, serial
        Identity.
    simulated
        Whether the hardware is simulated.
    x, y
        Range of positions on the film, in m.
    samples
        Range of samples per A-line.
    sampling_interval
        Range, in s.
    pulse_rate
        Range, in Hz.
    averages
        Range of shots per point.
    wavelength
        Range of the interrogation wavelength, in m.
    adc_bits
        Resolution of the digitiser.
    clock_rate
        Device seconds per host second: 1 on hardware.
    line_rate
        Bytes per second the line carries; 0 when nothing paces it.
    lease_cap
        Longest laser lease the device grants, in s of device time.
    encodings
        Encodings of A-lines it can send.
    beams
        Points interrogated at a time.
    beam_offsets
        (x, y) of each beam beside the first one, in m; the first is (0, 0).
    tuning_time
        Seconds one step of a wavelength sweep takes.
    gate
        Whether points may wait for an edge at the scanner's gate input.
    pulse_energy
        Nominal pulse energy in J, to which an A-line's is relative; 0: not known.
    energy_range
        Pulse energies, relative to nominal, beyond which a pulse is a misfire; ``None``: not watched.
    film
        Of a simulated scanner: "ideal", or the shortcomings that its film has; "" where the scanner does not say.
    parameters
        What :meth:`fabry_perot.Scanner.set` changes, with its range.
    """

    model: str
    serial: str
    simulated: bool
    x: Range
    y: Range
    samples: tuple[int, int]
    sampling_interval: Range
    pulse_rate: Range
    averages: tuple[int, int]
    wavelength: Range
    adc_bits: int
    clock_rate: float
    line_rate: int
    lease_cap: float
    encodings: tuple[int, ...] = (0,)
    beams: int = 1
    beam_offsets: tuple[Range, ...] = ((0.0, 0.0),)
    tuning_time: float = 0.0
    gate: bool = False
    pulse_energy: float = 0.0
    energy_range: Range | None = None
    film: str = ""
    parameters: Mapping[str, Range] = field(default_factory=dict)

    @classmethod
    def from_map(cls, data: Mapping[str, Any]) -> Capabilities:
        """Create the capabilities from a device's CBOR map; a map that lacks an entry raises FrameError."""

        def span(pair: Any, unit: float = 1.0) -> Range:
            low, high = pair
            return float(low) * unit, float(high) * unit

        try:
            offsets = tuple(span(pair, 1e-9) for pair in data.get("beam_offsets_nm", [[0, 0]]))
            if len(offsets) != int(data["beams"]) or offsets[0] != (0.0, 0.0):
                raise ValueError(f"offsets of {len(offsets)} beams of {data['beams']}, the first at {offsets[:1]}")
            return cls(
                model=str(data["model"]),
                serial=str(data["serial"]),
                simulated=bool(data["simulated"]),
                x=span(data["x_nm"], 1e-9),
                y=span(data["y_nm"], 1e-9),
                samples=(int(data["samples"][0]), int(data["samples"][1])),
                sampling_interval=span(data["interval_ps"], 1e-12),
                pulse_rate=span(data["pulse_rate_mhz"], 1e-3),
                averages=(int(data["averages"][0]), int(data["averages"][1])),
                wavelength=span(data["wavelength_pm"], 1e-12),
                adc_bits=int(data["adc_bits"]),
                clock_rate=float(data["clock_rate"]),
                line_rate=int(data["line_rate"]),
                lease_cap=float(data["lease_cap_us"]) * 1e-6,
                encodings=tuple(int(value) for value in data["encodings"]),
                beams=int(data["beams"]),
                beam_offsets=offsets,
                tuning_time=float(data.get("tuning_us", 0)) * 1e-6,
                gate=bool(data.get("gate", False)),
                pulse_energy=float(data.get("energy_nj", 0)) * 1e-9,
                energy_range=span(data["energy_range"], 1e-4) if "energy_range" in data else None,
                film=str(data.get("film", "")),
                parameters={str(name): span(pair) for name, pair in data.get("parameters", {}).items()},
            )
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            raise FrameError(f"capabilities lack or garble {error}") from error

    def alines_per_second(self, samples: int) -> float:
        """Return the A-lines of ``samples`` that the line carries per second at 90 % load; ``inf`` without a limit."""
        if not self.line_rate:
            return float("inf")
        return 0.9 * self.line_rate / encoded_size(_ALINE_OVERHEAD + 2 * samples)

    def encoding(self, name: str) -> int:
        """Return the number of an encoding by name; ``"auto"`` compresses A-lines if the line's rate is limited.

        Raises
        ------
        PlanInvalid
            The scanner does not have it.
        """
        if name == "auto":
            packs = self.line_rate > 0 and Encoding.DELTA_RICE in self.encodings
            return Encoding.DELTA_RICE if packs else Encoding.INT16
        if name not in NAMES or NAMES[name] not in self.encodings:
            allowed = ["auto", *(word for word, value in NAMES.items() if value in self.encodings)]
            raise PlanInvalid("encoding", name, " | ".join(allowed))
        return NAMES[name]

    def wavelengths(self, given: ArrayLike, count: int) -> NDArray[np.float64]:
        """Validate interrogation wavelengths (m), one or (``count``,), 0 for the device's map; raises PlanInvalid."""
        values = np.asarray(given, dtype=np.float64)
        low, high = self.wavelength
        if values.ndim and values.shape != (count,):
            raise PlanInvalid("wavelength", f"shape {values.shape}", f"one value or ({count},), in m")
        if not np.all((values == 0) | ((values > low - 1e-15) & (values < high + 1e-15))):
            raise PlanInvalid("wavelength", f"{values.min():g} … {values.max():g} m", f"0, or {low:g} … {high:g} m")
        return values

    def gated(self, given: ArrayLike, count: int) -> NDArray[np.bool_]:
        """Validate which points wait for the gate, one value or (``count``,) booleans; raises PlanInvalid."""
        values = np.asarray(given, dtype=np.bool_)
        if values.ndim and values.shape != (count,):
            raise PlanInvalid("gated", f"shape {values.shape}", f"one value or ({count},)")
        if values.any() and not self.gate:
            raise PlanInvalid("gated", "true", "false: this scanner has no gate input")
        return values

    def check_beams(self, count: int) -> None:
        """Raise PlanInvalid when the scanner has fewer than ``count`` beams."""
        if not 1 <= count <= self.beams:
            raise PlanInvalid("beams", count, f"1 … {self.beams}" if self.beams > 1 else "1, all this scanner has")

    def check(
        self,
        points: NDArray[np.float64],
        *,
        samples: int,
        sampling_interval: float,
        pulse_rate: float,
        averages: int,
        encoding: str = "auto",
    ) -> None:
        """Raise :class:`PlanInvalid` when points or sampling exceed the scanner's limits.

        Parameters
        ----------
        points
            (M, 2) positions on the film, in m.
        samples, sampling_interval, pulse_rate, averages, encoding
            As in :meth:`fabry_perot.Scanner.upload`.
        """
        if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
            raise PlanInvalid("points", f"shape {points.shape}", "(M, 2), M ≥ 1, in m")
        if not np.all(np.isfinite(points)):
            raise PlanInvalid("points", "not finite", "finite positions in m")
        _check_range("samples", samples, self.samples, "")
        _check_range("sampling_interval", sampling_interval, self.sampling_interval, " s")
        _check_range("pulse_rate", pulse_rate, self.pulse_rate, " Hz")
        _check_range("averages", averages, self.averages, "")
        self.encoding(encoding)
        for axis, (name, (low, high)) in enumerate((("x", self.x), ("y", self.y))):
            values = points[:, axis]
            if values.min() < low - 1e-9 or values.max() > high + 1e-9:
                worst = values[np.argmax(np.abs(values - (low + high) / 2))]
                raise PlanInvalid(f"points.{name}", f"{worst:g} m", f"{low:g} … {high:g} m")


def _check_range(name: str, value: float, allowed: Range, unit: str) -> None:
    low, high = allowed
    slack = 1e-9 * abs(high)
    if not low - slack <= value <= high + slack:
        raise PlanInvalid(name, f"{value}{unit}", f"{low:g} … {high:g}{unit}")
