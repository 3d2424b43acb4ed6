"""How long a reconstruction takes beside the bare transforms of its volume."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from steradian.benchmarks.cases import INTERVAL, SPEED, Case, speed_cases
from steradian.imaging import ReconstructionPlan
from steradian.imaging.workers import available
from steradian.progress import Progress

Row: TypeAlias = dict[str, Any]


def speed(*, quick: bool = False, repeats: int = 5, progress: Progress | None = None) -> list[Row]:
    """Time every case.

    Parameters
    ----------
    quick
        Small versions of all cases: a check that they run, no measurement.
    repeats
        Runs a case; the median counts. One more, not counted, comes first.
    progress
        Called before each case.

    Returns
    -------
    list of dict
        One row a case. ``yardstick_s``: scipy.fft rfftn + irfftn of the output array, float32, all processors, in
        turns with our runs; ``ratio``: ``run_s`` to it, medians both; ``plan_s``; stages; ``extra_memory``: peak
        beyond input and output as a part of the output; ``ned_s`` and ``finufft_s``: the lateral step alone, for
        scattered sensors in cases that have a limit.
    """
    cases = speed_cases(quick=quick)
    rows = []
    for i, case in enumerate(cases):
        if progress is not None:
            progress(case.name, i, len(cases))
        rows.append(_row(case, repeats))
    if progress is not None:
        progress("done", len(cases), len(cases))
    return rows


def _row(case: Case, repeats: int) -> Row:
    positions, weights = case.positions()
    begin = time.perf_counter()
    plan = ReconstructionPlan(
        positions,
        samples=case.samples,
        sampling_interval=INTERVAL,
        sound_speed=SPEED,
        aperture=case.aperture,
        modes=case.modes,
        weights=weights,
        **dict(case.options),
    )
    planned = time.perf_counter() - begin
    traces = np.random.default_rng(1).standard_normal((len(positions), case.samples), dtype=np.float32)
    shape = plan.geometry.shape
    bare = _yardstick(shape)
    yardsticks, runs, stages = [], [], []
    for _ in range(repeats + 1):
        yardsticks.append(bare())
        clock = _Stages()
        begin = time.perf_counter()
        plan.run(traces, progress=clock)
        runs.append(time.perf_counter() - begin)
        stages.append(clock.seconds())
    del bare
    yardstick = float(np.median(yardsticks[1:]))
    tracemalloc.start()
    volume = plan.run(traces)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    seconds = float(np.median(runs[1:]))
    row: Row = {
        "case": case.name,
        "method": plan.method,
        "sensors": len(positions),
        "shape": "×".join(map(str, shape)),
        "plan_s": planned,
        "run_s": seconds,
        "fastest_s": min(runs[1:]),
        "yardstick_s": yardstick,
        "ratio": seconds / yardstick,
        "limit": case.limit,
        "extra_memory": peak / volume.values.nbytes - 1.0,  # type: ignore[union-attr]
    }
    for name in stages[-1]:
        row[name.replace(" ", "_") + "_s"] = float(np.median([s[name] for s in stages[1:]]))
    if plan.method == "nedner" and np.ndim(positions) == 2 and case.limit is not None:
        row["ned_s"] = row["lateral_transform_s"]
        row["finufft_s"] = _finufft(positions, case, min(repeats, 3))
    return row


class _Stages:
    """A progress callable that notes when each stage begins."""

    def __init__(self) -> None:
        self.marks: list[tuple[str, float]] = []

    def __call__(self, stage: str, done: int, total: int) -> None:
        if not self.marks or self.marks[-1][0] != stage:
            self.marks.append((stage, time.perf_counter()))
        self.end = time.perf_counter()

    def seconds(self) -> dict[str, float]:
        ends = [at for _, at in self.marks[1:]] + [self.end]
        return {stage: end - at for (stage, at), end in zip(self.marks, ends, strict=True)}


def _yardstick(shape: tuple[int, ...]) -> Callable[[], float]:
    """Make a function that transforms a volume there and back and returns the seconds that took."""
    from scipy import fft

    volume = np.empty(shape, np.float32)
    volume[...] = np.random.default_rng(2).standard_normal(shape[-1], dtype=np.float32)

    def transform() -> float:
        begin = time.perf_counter()
        fft.irfftn(fft.rfftn(volume, workers=available()), shape, workers=available())
        return time.perf_counter() - begin

    return transform


def _finufft(positions: np.ndarray[Any, Any], case: Case, repeats: int) -> float | None:
    """FINUFFT's best setting for the same sums: pairs of samples as complex vectors, 64 a call, upsampling 1.25.

    On a busy machine one thread beats several (its threads wait for one another by spinning), so both are tried.
    """
    try:
        import finufft
    except ImportError:
        return None
    vectors = 64
    angles = (2 * np.pi * positions / case.aperture).astype(np.float32)
    x, y = np.ascontiguousarray(angles[:, 0]), np.ascontiguousarray(angles[:, 1])
    data = np.ones((vectors, len(positions)), np.complex64)
    out = np.empty((vectors, case.modes, case.modes), np.complex64)
    medians = []
    for threads in {1, available()}:
        plan = finufft.Plan(
            1, (case.modes, case.modes), vectors, 1e-4, -1, dtype="complex64", upsampfac=1.25, nthreads=threads
        )
        plan.setpts(x, y)
        seconds = []
        for _ in range(repeats + 1):
            begin = time.perf_counter()
            for _ in range(-(-case.samples // 2 // vectors)):
                plan.execute(data, out)
            seconds.append(time.perf_counter() - begin)
        medians.append(float(np.median(seconds[1:])))
    return min(medians)
