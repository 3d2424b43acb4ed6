"""Simulated cards: the subset of ``nidaqmx`` that the example uses, and a digitiser with a ring buffer of records."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.table import GATE_EDGES, OpticalTable, RecordRing, TriggerTrain

constants = SimpleNamespace(
    AcquisitionType=SimpleNamespace(FINITE="finite"),
    TriggerType=SimpleNamespace(DIGITAL_LEVEL="digital level"),
    Level=SimpleNamespace(LOW="low"),
)


class Cards:
    """Substitute for the package ``nidaqmx``: a DAQ card connected to the simulated optical table."""

    constants = constants

    def __init__(self, table: OpticalTable) -> None:
        self._table = table

    def Task(self) -> _Task:  # noqa: N802 - its name in nidaqmx
        """Create a DAQ task."""
        return _Task(self._table)


class _Task:
    """Simulated DAQ task; its channels define its function."""

    def __init__(self, table: OpticalTable) -> None:
        self._table, self._kind, self._settings = table, "", dict[str, Any]()
        self._data: list[tuple[float, float]] = []
        self.ao_channels = SimpleNamespace(add_ao_voltage_chan=self._channel("ao"))
        self.do_channels = SimpleNamespace(add_do_chan=self._channel("do"))
        self.di_channels = SimpleNamespace(add_di_chan=self._channel("di"))
        self.ci_channels = SimpleNamespace(add_ci_count_edges_chan=self._channel("ci"))
        self.co_channels = SimpleNamespace(
            add_co_pulse_chan_freq=self._channel("train"), add_co_pulse_chan_time=self._channel("gate")
        )
        self.timing = SimpleNamespace(cfg_samp_clk_timing=self._timing, cfg_implicit_timing=self._timing)
        self.triggers = SimpleNamespace(
            pause_trigger=SimpleNamespace(),
            start_trigger=SimpleNamespace(cfg_dig_edge_start_trig=self._at_edge),
        )
        self._waits = False

    def _channel(self, kind: str) -> Any:
        def add(name: str, **settings: Any) -> None:
            self._kind, self._settings = kind, {"name": name, **settings}

        return add

    def _at_edge(self, source: str) -> None:
        if not source.endswith(GATE_EDGES):
            raise RuntimeError(f"DaqError -89120: nothing is wired to {source}")
        self._waits = True

    def _timing(self, *_: Any, **settings: Any) -> None:
        self._settings |= settings

    def write(self, data: Any, auto_start: bool = True) -> None:
        """Write output data to the card, which applies them immediately or at :meth:`start`."""
        self._table.advance()
        if self._kind == "do":
            self._table.shutter_driven = bool(data)
        elif auto_start:
            self._table.volts = np.asarray(data, dtype=np.float64)
        else:
            self._data = [(float(u), float(v)) for u, v in zip(*data, strict=True)]
        if np.abs(np.asarray(data, dtype=np.float64)).max() > 10:
            raise RuntimeError("DaqError -200077: requested value is not a supported value: 10 V at most")

    def start(self) -> None:
        """Start the task."""
        table = self._table
        table.advance()
        if self._kind == "ao":
            if len(self._data) != self._settings["samps_per_chan"]:
                raise RuntimeError("DaqError -200462: fewer samples written than generated")
            table.table = list(self._data)
        elif self._kind == "train":
            begin = table.next_edge() if self._waits else table.clock()
            table.train = TriggerTrain(begin, 1 / self._settings["freq"], self._settings["samps_per_chan"])
        elif self._kind == "gate":
            table.gate = table.clock() + self._settings["high_time"]

    def read(self) -> Any:
        """Return the level of a digital line, or the count of a counter."""
        table = self._table
        table.advance()
        if self._kind == "ci":
            return table.shots
        line = int(self._settings["name"].rpartition("line")[2])
        light = table.shutter_open and table.train is not None and table.train.left > 0
        return {1: not table.shutter_open, 2: table.interlock, 3: table.key, 4: light}[line]

    def close(self) -> None:
        """Stop the task and release the card's resources."""
        table = self._table
        table.advance()
        if self._kind == "ao":
            table.table = []
        elif self._kind == "train":
            table.train = None
        elif self._kind == "gate":
            table.gate = 0.0


class DigitiserCard:
    """Simulated 14-bit, ±0.1 V digitiser card with a ring buffer of a thousand records."""

    full_scale = 8191
    volts_per_count = 0.1 / 8192
    ring = 1000

    def __init__(self, table: OpticalTable) -> None:
        self._table = table

    def setup(self, samples: int, interval: float) -> None:
        """Set number of samples and sampling interval (s) of records."""
        self._table.setup(samples, interval)

    def start(self, records: int) -> None:
        """Start recording of ``records`` triggers."""
        self._table.advance()
        self._table.ring.wanted = records

    def stop(self) -> None:
        """Stop recording and clear the ring buffer."""
        self._table.advance()
        self._table.ring = RecordRing(self._table.ring.samples)

    def available(self) -> int:
        """Return the number of records in the ring buffer."""
        self._table.advance()
        waiting = len(self._table.ring.entries)
        if waiting > self.ring:
            raise RuntimeError("the ring overran")
        return waiting

    def read(self, count: int) -> tuple[NDArray[np.int16], NDArray[np.int64], NDArray[np.int64]]:
        """Return records (count, N_t), their times in µs of the card's clock, and their shot numbers."""
        entries, ring = self._table.ring.entries[:count], self._table.ring
        del ring.entries[:count]
        rows = np.zeros((len(entries), ring.samples), np.int16)
        for row, (x, y, wavelength, _, shot) in zip(rows, entries, strict=True):
            counts = np.rint(self._table.signal(x, y, wavelength, shot) / self.volts_per_count)
            row[:] = np.clip(counts, -self.full_scale - 1, self.full_scale)
        return (
            rows,
            np.array([each[3] for each in entries], np.int64),
            np.array([each[4] for each in entries], np.int64),
        )

    def clock(self) -> int:
        """Return the time of the card's clock in µs."""
        return round(1e6 * self._table.clock())

    def mean(self) -> float:
        """Return the DC level of the input in V."""
        self._table.advance()
        return self._table.level()
