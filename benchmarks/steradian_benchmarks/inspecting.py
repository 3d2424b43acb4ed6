"""Benchmark of the A-line inspection (``quality.inspect_signals``), against an FFT of the same array."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from steradian.core.progress import Progress
from steradian.quality.signals import CHUNK, inspect_signals

ALINES, SAMPLES, INTERVAL, PITCH = 50_000, 1024, 8e-9, 100e-6
LIMIT_S: Final = 2.0
"""Seconds that the inspection of all A-lines must not exceed."""


def inspecting(*, quick: bool = False, repeats: int = 5, progress: Progress | None = None) -> list[dict[str, Any]]:
    """Time the inspection of 50,000 A-lines of 1,024 16-bit samples, a pulse in noise, on a square grid.

    Parameters
    ----------
    quick
        2,000 A-lines: a check that it runs, no measurement.
    repeats
        Runs of each, in turns; the fastest counts.
    progress
        Called after each run.

    Returns
    -------
    list of dict
        One row: ``inspect_s``, ``yardstick_s`` (``scipy.fft.rfft`` of all A-lines as float32, block by block, one
        thread), their ``ratio``, ``cpu_s`` of the inspection, and ``limit_s``.
    """
    from scipy.fft import rfft

    count = 2_000 if quick else ALINES
    line = np.arange(int(np.ceil(np.sqrt(count)))) * PITCH
    positions = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)[:count]
    traces = np.random.default_rng(1).normal(0, 300, (count, SAMPLES)).astype(np.int16)
    traces[:, 300:340] += np.rint(2000 * np.sin(np.arange(40) / 3)).astype(np.int16)

    def yardstick() -> None:
        for first in range(0, count, CHUNK):
            rfft(traces[first : first + CHUNK].astype(np.float32), axis=1)

    ours, theirs = [], []
    for done in range(repeats):
        theirs.append(_timed(yardstick))
        ours.append(_timed(lambda: inspect_signals(traces, INTERVAL, positions)))
        if progress is not None:
            progress("inspections", done + 1, repeats)
    (wall, cpu), (plain, _) = min(ours), min(theirs)
    row: dict[str, Any] = {"alines": count, "samples": SAMPLES, "inspect_s": wall, "cpu_s": cpu}
    return [row | {"yardstick_s": plain, "ratio": wall / plain, "limit_s": LIMIT_S}]


def _timed(work: Callable[[], object]) -> tuple[float, float]:
    """Call a function and return wall-clock and processor time in seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - cpu
