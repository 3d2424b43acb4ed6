"""Interrogation laser with the SCPI commands of the HP/Agilent/Keysight 8168, controlled through PyVISA.

Of its commands ``:WAVelength``, ``:POWer``, ``:POWer:STATe`` are used, and of IEEE 488.2 ``*OPC``, ``*ESR?`` and
``*CLS``. Nothing waits: ``*OPC`` has the laser set a bit of its event register when it is tuned, and
:meth:`ScpiLaser.tuned` reads that register.

A laser that was switched off, or whose cable was out, is a fault of the scanner, in VISA's words. Its session is then
given up, and the next question opens another one, in which the laser is set up anew.
"""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Any

import numpy as np
import pyvisa

from fabry_perot import TuningMap

OPERATION_COMPLETE, ERRORS = 0x01, 0x3C
"""Bits of the standard event register: done; query, device, execution or command error."""
OPENING, AGAIN = 1_000, 1.0
"""Longest wait for a connection, in ms, and time between two attempts at one, in s."""


class ScpiLaser:
    """:class:`~fabry_perot.hardware.InterrogationLaser` controlled by SCPI commands over VISA.

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
        self._resource, self._manager = resource, pyvisa.ResourceManager(backend)
        self._tuning_us, self._film, self._tuned = tuning_us, film, True
        self._visa: Any = None
        self._tried = -AGAIN
        low, high = (float(self._query(f":WAV? {end}")) for end in ("MIN", "MAX"))
        self._range = [round(low * 1e12), round(high * 1e12)]

    def _open(self) -> None:
        """Open a VISA session, switch the laser on, and query its wavelength, which may have changed meanwhile."""
        if time.monotonic() - self._tried < AGAIN:
            raise ConnectionError(f"{self._resource} does not answer; is it on?")
        self._tried = time.monotonic()
        self._visa = self._manager.open_resource(
            self._resource,
            read_termination="\n",
            write_termination="\n",
            timeout=2_000,
            open_timeout=OPENING,
        )
        self._visa.write("*CLS")
        self.wavelength, self._tuned = round(float(self._visa.query(":WAV?")) * 1e12), True
        self._visa.write(":POW:STAT ON")

    def _write(self, command: str) -> None:
        """Send a SCPI command."""
        self._talk("write", command)

    def _query(self, question: str) -> str:
        """Send a SCPI query and return the answer."""
        return str(self._talk("query", question))

    def _talk(self, how: str, words: str) -> Any:
        """Call a method of the VISA session, which is reopened after a loss; a failed session is closed."""
        try:
            if self._visa is None:
                self._open()
            return getattr(self._visa, how)(words)
        except (pyvisa.Error, OSError, ValueError) as error:
            self._give_up()
            raise ConnectionError(f"the laser {self._resource} was lost ({error})") from error

    def _give_up(self) -> None:
        lost, self._visa = self._visa, None
        if lost is not None:
            with suppress(pyvisa.Error, OSError):
                lost.close()

    def limits(self) -> dict[str, Any]:
        """Return the wavelength range reported by the instrument, the tuning time, and the adjustable parameters."""
        power = {"interrogation_uw": [100, 5_000]}
        return {"wavelength_pm": self._range, "tuning_us": self._tuning_us, "parameters": power}

    def bias(self, x: int, y: int) -> int:
        """Return the optimum wavelength at the nearest point of the tuning map, or the present wavelength."""
        if self._film is None:
            return self.wavelength
        nearest = np.argmin(np.hypot(*(self._film.points - [1e-9 * x, 1e-9 * y]).T))
        return round(float(self._film.wavelength[nearest]) * 1e12)

    def tune(self, wavelength: int, now: int) -> None:
        """Start tuning to a wavelength (pm)."""
        if wavelength != self.wavelength:
            self._write(f":WAV {1e-3 * wavelength:.4f}NM;*OPC")
            self.wavelength, self._tuned = wavelength, False

    def tuned(self, now: int) -> bool:
        """Return whether the laser has reached the wavelength."""
        if not self._tuned:
            self._tuned = bool(self._events() & OPERATION_COMPLETE)
        return self._tuned

    def parameters(self) -> dict[str, int]:
        """Return the laser's power in µW."""
        return {"interrogation_uw": round(float(self._query(":POW?")) * 1e6)}

    def configure(self, name: str, value: int) -> None:
        """Set the laser's power in µW."""
        self._write(f":POW {value}UW")
        self._events()

    def close(self) -> None:
        """Switch the light off and close the session."""
        with suppress(ConnectionError):  # a laser that is gone is dark, and one that is off needs no session for it
            if self._visa is not None:
                self._write(":POW:STAT OFF")
        self._give_up()

    def _events(self) -> int:
        """Return the standard event register; raises RuntimeError with the instrument's message for an error bit."""
        events = int(self._query("*ESR?"))
        if events & ERRORS:
            raise RuntimeError(f"the laser reports {self._query(':SYST:ERR?')}")
        return events
