"""The interrogation laser: a tunable laser that speaks SCPI as the HP/Agilent/Keysight 8168 does, through PyVISA.

Of its commands ``:WAVelength``, ``:POWer``, ``:POWer:STATe`` are used, and of IEEE 488.2 ``*OPC``, ``*ESR?`` and
``*CLS``. Nothing waits: ``*OPC`` has the laser set a bit of its event register when it is tuned, and
:meth:`ScpiLaser.tuned` reads that register.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyvisa

from fabry_perot import TuningMap

OPERATION_COMPLETE, ERRORS = 0x01, 0x3C
"""Bits of the standard event register: done; query, device, execution or command error."""


class ScpiLaser:
    """An :class:`~fabry_perot.hardware.InterrogationLaser`.

    Parameters
    ----------
    resource
        VISA name: ``TCPIP::HOST::PORT::SOCKET``, ``GPIB0::20::INSTR``, ``USB0::…``.
    tuning_us
        What a retuning takes, for the host's estimate of a sweep's time.
    film
        Map of the film for points whose plan names no wavelength; none: the same everywhere.
    backend
        Of PyVISA: ``@py`` needs no vendor's library.
    """

    def __init__(self, resource: str, *, tuning_us: int = 5_000, film: TuningMap | None = None, backend: str = "@py"):
        self._visa = pyvisa.ResourceManager(backend).open_resource(
            resource, read_termination="\n", write_termination="\n", timeout=2_000
        )
        self._tuning_us, self._film, self._tuned = tuning_us, film, True
        self._visa.write("*CLS")
        low, high = (float(self._visa.query(f":WAV? {end}")) for end in ("MIN", "MAX"))
        self._range = [round(low * 1e12), round(high * 1e12)]
        self.wavelength = round(float(self._visa.query(":WAV?")) * 1e12)
        self._visa.write(":POW:STAT ON")

    def limits(self) -> dict[str, Any]:
        """Return its range, as the instrument says it, and what can be changed."""
        power = {"interrogation_uw": [100, 5_000]}
        return {"wavelength_pm": self._range, "tuning_us": self._tuning_us, "parameters": power}

    def bias(self, x: int, y: int) -> int:
        """Return the wavelength of the nearest place of the film's map."""
        if self._film is None:
            return self.wavelength
        nearest = np.argmin(np.hypot(*(self._film.points - [1e-9 * x, 1e-9 * y]).T))
        return round(float(self._film.wavelength[nearest]) * 1e12)

    def tune(self, wavelength: int, now: int) -> None:
        """Begin to tune."""
        if wavelength != self.wavelength:
            self._visa.write(f":WAV {1e-3 * wavelength:.4f}NM;*OPC")
            self.wavelength, self._tuned = wavelength, False

    def tuned(self, now: int) -> bool:
        """Return whether the laser says that it is there."""
        if not self._tuned:
            self._tuned = bool(self._events() & OPERATION_COMPLETE)
        return self._tuned

    def parameters(self) -> dict[str, int]:
        """Return its power."""
        return {"interrogation_uw": round(float(self._visa.query(":POW?")) * 1e6)}

    def configure(self, name: str, value: int) -> None:
        """Change its power."""
        self._visa.write(f":POW {value}UW")
        self._events()

    def close(self) -> None:
        """Turn its light off and leave it."""
        self._visa.write(":POW:STAT OFF")
        self._visa.close()

    def _events(self) -> int:
        """Return the event register; an error in it is raised with what the instrument says of it."""
        events = int(self._visa.query("*ESR?"))
        if events & ERRORS:
            raise RuntimeError(f"the laser reports {self._visa.query(':SYST:ERR?')}")
        return events
