"""Model of a scanner: limits, motion, tuning and link throughput."""

from __future__ import annotations

from math import ceil
from typing import Self

from pydantic import Field, model_validator

from steradian.core.exceptions import InvalidInput
from steradian.core.validation import Value, quantity_field

STANDARD_BAUD = (9600, 115_200, 460_800, 921_600, 3_000_000, 6_000_000, 12_000_000)
"""Baud rates that serial adapters offer."""


REPORT_BYTES = 91
"""Bytes on the line of one status report."""


class ScannerLimits(Value):
    """Limits of a scanner: ranges from lowest to highest."""

    x: tuple[float, float] = Field(default=(-10e-3, 10e-3), description="Positions on the film (m)")
    y: tuple[float, float] = Field(default=(-10e-3, 10e-3), description="Positions on the film (m)")
    pulse_rate: tuple[float, float] = Field(default=(1.0, 10_000.0), description="Laser pulses per second (Hz)")
    averages: tuple[int, int] = Field(default=(1, 1000), description="Pulses averaged into one A-line")
    samples: tuple[int, int] = Field(default=(16, 16_384), description="Samples of an A-line")
    sampling_interval: tuple[float, float] = Field(default=(1e-9, 1e-6), description="Time between samples (s)")
    wavelength: tuple[float, float] = Field(default=(1.5e-6, 1.6e-6), description="Bias wavelength (m)")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name in type(self).model_fields:
            low, high = getattr(self, name)
            if low > high:
                raise InvalidInput(name, f"({low:g}, {high:g})", "lowest first, highest second")
        return self


class Motion(Value):
    """Motion of the beam from point to point: speed and settling time."""

    speed: float = quantity_field("m/s", "Speed of the beam on the film", gt=0, le=1e4, default=5.0)
    settling: float = quantity_field("s", "Time until the mirrors rest after a move", ge=0, le=60, default=400e-6)


class Tuning(Value):
    """Tuning speed and tolerance of the interrogation laser's bias wavelength."""

    settling: float = quantity_field("s", "Time until the wavelength is stable", ge=0, le=60, default=10e-3)
    speed: float = quantity_field("m/s", "Wavelength swept per second", gt=0, le=1, default=100e-9)
    tolerance: float = quantity_field("m", "Wavelengths this close need no retuning", ge=0, le=1e-6, default=10e-12)


class Link(Value):
    """Data rate, frame size and buffer of the scanner's link."""

    byte_rate: float | None = quantity_field(
        "B/s", "Bytes per second on the line; none: not limiting", gt=0, default=1_200_000.0
    )
    frame: int = quantity_field(
        "B", "Largest payload of a frame: 641 on a UART, 8192 on USB", ge=64, le=65_536, default=641
    )
    load: float = quantity_field("share", "Part of the line's time that A-lines may fill", gt=0, le=1, default=0.9)
    ring: int = quantity_field("A-lines", "How many the scanner holds before it stops firing", ge=1, default=512)
    reports: float = quantity_field("1/s", "Status reports a second", ge=0, le=1000, default=10.0)

    @classmethod
    def serial(cls, baud: float) -> Self:
        """Return the link of a UART: ten bits a byte."""
        if not baud > 0:
            raise InvalidInput("baud", baud, "> 0 (Bd)")
        return cls.create(byte_rate=baud / 10)

    @property
    def baudrate(self) -> int | None:
        """Baud rate of the UART; None for an unlimited link and for the default (USB)."""
        usual = type(self).model_fields["byte_rate"].default
        return None if self.byte_rate in (None, usual) else round(10 * self.byte_rate)

    def bytes_of(self, samples: int) -> int:
        """Return the bytes on the line of one A-line of ``samples`` 16-bit samples, framing included.

        44 bytes about the shot and the samples go in fragments; each has a head of 16 bytes and lies in a frame with
        10 bytes of header, 4 of checksum, 2 delimiters and one byte of stuffing in 254.
        """
        room = self.frame - 16
        content = 44 + 2 * samples
        frames = ceil(content / room)
        body = content + frames * (16 + 14)
        return body + frames * 3 + body // 254

    def seconds_of(self, alines: int, samples: int) -> float:
        """Return the transmission time in seconds of A-lines on an otherwise idle link.

        Status reports share the line. Once the scanner holds all it can, it stops firing before each A-line and goes
        on after it, and reports both.
        """
        if self.byte_rate is None:
            return 0.0
        each, held = self.bytes_of(samples), min(alines, self.ring)
        regular = max(self.byte_rate - self.reports * REPORT_BYTES, 0.1 * self.byte_rate)
        stop_and_go = max(each + 2 * REPORT_BYTES, each * self.byte_rate / regular)
        return held * each / regular + (alines - held) * stop_and_go / self.byte_rate

    def alines_per_second(self, samples: int) -> float:
        """Return the A-line rate of the link at its allowed load; infinite if unlimited."""
        return float("inf") if self.byte_rate is None else self.load * self.byte_rate / self.bytes_of(samples)

    def required_baud(self, alines_per_second: float, samples: int) -> int:
        """Return the smallest standard baud rate for ``rate`` A-lines a second; the exact rate if none suffices."""
        need = alines_per_second * self.bytes_of(samples) * 10 / self.load
        return next((baud for baud in STANDARD_BAUD if baud >= need), ceil(need / 1e6) * 1_000_000)
