"""Memory of a service's processes over time, and its rate of growth."""

from __future__ import annotations

import asyncio
import time
from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from steradian.benchmarks.service import memory_mib

NAMES = {
    "steradian.api.background.process_pool": "api's process pool",
    "steradian.api": "api",
    "steradian.runtime.acquisition": "acquisition",
    "steradian.runtime.worker_entry": "worker",
    "steradian.jobs.worker.child": "jobs' process",
    "fabry_perot.simulator": "simulator",
}
"""What stands in a process's command line, and what it is called here: the first that fits.

The one above them is the supervisor."""
SETTLING = 0.25
"""Share of a run in which caches fill; growth counts from then on."""


class MemorySampler:
    """Sampler of the resident memory of a service's processes during a load.

    Parameters
    ----------
    pid
        The service's own process.
    interval
        Seconds between two looks.
    """

    def __init__(self, pid: int, interval: float) -> None:
        self._pid, self._interval = pid, interval
        self._found: dict[str, list[tuple[float, float]]] = defaultdict(list)
        self._begun = time.monotonic()

    async def watch(self, over: asyncio.Event) -> None:
        """Sample the memory periodically until the load has ended."""
        while not over.is_set():
            self.sample()
            with suppress(TimeoutError):
                await asyncio.wait_for(over.wait(), self._interval)
        self.sample()

    def sample(self) -> None:
        """Sample the total memory of each kind of process; ended processes count as zero."""
        now = time.monotonic() - self._begun
        added = dict.fromkeys(self._found, 0.0)
        for pid, name in _family(self._pid):
            added[name] = added.get(name, 0.0) + memory_mib(pid)
        for name, mib in added.items():
            self._found[name].append((now, mib))

    def rows(self) -> list[dict[str, Any]]:
        """Return memory and growth per minute (least-squares slope) of each kind of process.

        ``error`` is the slope's standard error. What jobs hold goes up and down with them.
        """
        return [{"case": "memory", "process": name, **_growth(samples)} for name, samples in self._found.items()]


def _growth(samples: list[tuple[float, float]]) -> dict[str, Any]:
    seconds, mib = np.array(samples).T
    told = {"first_mib": mib[0], "last_mib": mib[-1], "most_mib": mib.max()}
    settled = seconds >= SETTLING * seconds[-1]
    if settled.sum() > 3:
        minutes = seconds[settled] / 60
        (slope, level), spread = np.polyfit(minutes, mib[settled], 1), np.square(minutes - minutes.mean()).sum()
        left = np.square(mib[settled] - slope * minutes - level).sum() / (settled.sum() - 2)
        told |= {"mib_per_minute": slope, "error": np.sqrt(left / spread)}
    numbers = {name: float(value) for name, value in told.items()}
    return numbers | {"over_time": [[round(at, 1), round(value, 1)] for at, value in samples]}


def _family(pid: int) -> list[tuple[int, str]]:
    """Return a process and its descendants with their names; empty if the system does not report them."""
    parents: dict[int, int] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, ValueError, IndexError):
            parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
    family = [pid] if pid in parents else []
    for each in family:
        family += [child for child, parent in parents.items() if parent == each]
    return [(each, _name(each)) for each in family]


def _name(pid: int) -> str:
    with suppress(OSError):
        command = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace")
        return next((name for part, name in NAMES.items() if part in command), "supervisor")
    return "supervisor"
