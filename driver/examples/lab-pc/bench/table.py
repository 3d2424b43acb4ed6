"""Simulated optical table: mirrors, lens, film, phantom, pulsed laser, shutter and wiring.

Nothing here is known to the parts that are tried on it: mirrors bend the scan field, the film has its own sensitivity
at every place, the digitiser starts late. What a lab would measure, :func:`calibration_marks` and the scanner's own
sweeps do.
"""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fabry_perot.hardware import PlanSampling
from fabry_perot.simulator import named_phantoms
from fabry_perot.simulator.film import LINEWIDTH, MAX_MODULATION, VISIBILITY, Response
from fabry_perot.simulator.signal_path import SignalPath, peak_pressure

DELAY = 120e-9
"""From the laser pulse to the first sample, in s."""
GATE_EDGES, GATE_PERIOD = "PFI2", 0.25
"""Terminal that a heart (or a stimulus) is wired to, and the time between its edges in s."""
SETTLES = 400
"""µs that the mirrors need."""


def film_place(volts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return beam positions on the film (m) for mirror voltages (N, 2): rotation, shear, pincushion and offset."""
    u, v = np.asarray(volts, dtype=np.float64).T
    x = 1.9e-3 * u - 0.05e-3 * v + 0.12e-3
    y = 0.06e-3 * u + 2.1e-3 * v - 0.08e-3
    swell = 1 + 1.2e-3 * (u**2 + v**2)
    return np.column_stack([x * swell, y * swell])


def calibration_marks(count: int = 9) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions (N, 2) of a calibration target's marks, and mirror voltages (N, 2) that hit them."""
    axis = np.linspace(-7e-3, 7e-3, count)
    places = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    volts = places / 2e-3
    for _ in range(60):  # turn the mirrors until the beam is on the mark
        volts = volts + (places - film_place(volts)) / 2e-3
    return places, volts


@dataclass
class TriggerTrain:
    """Pulse train of counter 0: first trigger, period and remaining pulses."""

    first: float
    period: float
    left: int


@dataclass
class RecordRing:
    """Ring buffer of the digitiser: triggered records that were not read yet."""

    samples: int = 0
    wanted: int = 0
    entries: list[tuple[float, float, float, int, int]] = field(default_factory=list)
    """x, y (m), wavelength (m), time (µs), number of the shot."""


class OpticalTable:
    """Simulated optical table; each call first processes the events since the previous call, at their own times.

    Parameters
    ----------
    laser
        Host and port of the interrogation laser, whose light falls on the film.
    phantom
        Name of the object.
    """

    def __init__(self, laser: tuple[str, int], phantom: str = "yarn", seed: int = 0) -> None:
        self.recorder = SignalPath(
            named_phantoms.by_name(phantom, seed),
            seed=seed,
            response=Response(nonlinear=True),
            energy_jitter=0.0,
            noise_db=40.0,
            time_zero=DELAY,
            relief="wedge",
        )
        peak = peak_pressure(named_phantoms.by_name(phantom, seed), 1500.0)
        self.shift = 1e-12 * MAX_MODULATION * LINEWIDTH / 2 / peak
        """How far a pressure moves the film's resonance, in m per unit of pressure."""
        self._connection = socket.create_connection(laser)
        self._fibre = self._connection.makefile("rw")
        self.volts = np.zeros(2)
        self.table: list[tuple[float, float]] = []
        self.train: TriggerTrain | None = None
        self.gate = 0.0
        """Until when, in s of the table's clock, counter 1 is high."""
        self.shutter_driven = False
        self.interlock = self.key = True
        self.shots = 0
        self.ring = RecordRing()

    @staticmethod
    def clock() -> float:
        """Return the time of the table's clock in s."""
        return time.monotonic()

    def next_edge(self) -> float:
        """Return the time of the next edge at the gate input, in s of the table's clock."""
        return (self.clock() // GATE_PERIOD + 1) * GATE_PERIOD

    def light(self) -> float:
        """Return the wavelength of the interrogation light, in m; 0 while the laser is dark."""
        self._fibre.write(":LIGH?\n")
        self._fibre.flush()
        wavelength, power = map(float, self._fibre.readline().split(","))
        return wavelength if power > 0 else 0.0

    def close(self) -> None:
        """Close the connection to the laser."""
        self._fibre.close()
        self._connection.close()

    @property
    def shutter_open(self) -> bool:
        """Whether the shutter is open: driven, with interlock closed and key on."""
        return self.shutter_driven and self.interlock and self.key

    def setup(self, samples: int, interval: float) -> None:
        """Set number of samples and sampling interval of the digitiser's records."""
        self.ring = RecordRing(samples)
        self.recorder.begin(PlanSampling(samples, round(interval * 1e12), 1))

    def advance(self) -> None:
        """Process all triggers due by now: fire, record, and step the mirrors."""
        train, now = self.train, self.clock()
        while train is not None and train.left and train.first <= now:
            time_, train.first = train.first, train.first + train.period
            if time_ >= self.gate or not (self.interlock and self.key):
                continue
            train.left -= 1
            self.shots += 1
            if self.ring.wanted:
                self.ring.wanted -= 1
                x, y = film_place(self.volts[None])[0]
                self.ring.entries.append((x, y, self.light(), round(1e6 * time_), self.shots))
            if self.table:
                self.volts = np.array(self.table.pop(0))

    def level(self) -> float:
        """Return the photodiode voltage of the reflected light, in V."""
        wavelength = self.light()
        x, y = np.rint(1e9 * film_place(self.volts[None])[0]).astype(int).tolist()
        return 1e-3 * self.recorder.level(x, y, round(1e12 * wavelength)) if wavelength else 0.0

    def signal(self, x: float, y: float, wavelength: float, shot: int) -> NDArray[np.float64]:
        """Return a shot's record (N_t,) in V, from pressure, film slope and resonance shift at its position."""
        if not self.shutter_open or not wavelength:
            return np.zeros(self.ring.samples)
        place = (round(1e9 * x), round(1e9 * y))
        record = self.recorder.record(*place, round(1e12 * wavelength), shot)
        level = float(self.recorder.film.dc_level(*place, np.array([1e12]))[0])  # far off resonance
        slope = 1e-3 * level * VISIBILITY * (3 * np.sqrt(3) / 8) / (1e-12 * LINEWIDTH / 2)
        volts: NDArray[np.float64] = record.samples.astype(np.float64) * record.scale * slope * self.shift
        return volts
