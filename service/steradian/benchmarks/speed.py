"""Benchmark of the reconstruction time, in units of the FFT pair of the same volume."""

from __future__ import annotations

import time
import tracemalloc
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from steradian.benchmarks.machine_limits import Machine, Timing, fft_pair_baselines, lower_bound, machine_limits, timed
from steradian.benchmarks.speed_cases import INTERVAL, SPEED, Case, speed_cases
from steradian.core.progress import Progress
from steradian.imaging import (
    AcquisitionGeometry,
    Compute,
    ImageGrid,
    ReconstructionPlan,
    Volume,
    direct_spectrum,
    reconstruct,
)
from steradian.imaging.compute.thread_pool import available_threads

Row: TypeAlias = dict[str, Any]
_POINTS = 24  # of the spectrum, that are compared with direct sums
CPU = Compute(device="cpu")


def speed(*, quick: bool = False, repeats: int = 5, progress: Progress | None = None) -> list[Row]:
    """Time the reconstruction of every case.

    Parameters
    ----------
    quick
        Small versions of all cases: a check that they run, no measurement.
    repeats
        Runs a case; the fastest counts, of wall clock and of processor time. One more, not counted, comes first.
    progress
        Called before each shape.

    Returns
    -------
    list of dict
        One row a case. ``yardstick_s``: transforms of a float32 array of the image's shape (with the record's length)
        there and back on the same threads, by the faster of ducc0 and SciPy; one for all cases of a shape, in turns
        with our runs. ``ratio``: ``run_s`` to it, ``one_shot_ratio``: a call of ``reconstruct()``, plan included; the
        names with ``cpu`` are processor time. ``part``: ``run_s`` to that of the shape's first case. ``error``:
        relative l2 error of the spectrum at random points against direct float64 sums. ``extra_memory``: peak beyond
        input and output as a part of the output. ``traffic_s`` and ``arithmetic_s``: what either alone would take on
        this machine. ``ned_s`` and ``finufft_s``: the lateral step alone, for scattered sensors in cases that have a
        limit. ``within``: no limit is exceeded.
    """
    groups: dict[tuple[int, ...], list[_Timed]] = {}
    at_best = machine_limits(available_threads(), size=1 << 16 if quick else 1 << 25)
    for case in speed_cases(quick=quick):
        made = _Timed(case)
        groups.setdefault((*made.plan.geometry.shape[:-1], int(made.plan.geometry.record)), []).append(made)
    rows: list[Row] = []
    for i, (shape, cases) in enumerate(groups.items()):
        if progress is not None:
            progress("×".join(map(str, shape)), i, len(groups))
        rows += _group(shape, cases, repeats, at_best)
    if progress is not None:
        progress("done", len(groups), len(groups))
    return rows


def limit_violations(rows: list[Row]) -> list[str]:
    """Return a message for each case that exceeds its limit."""
    return [
        f"{row['case']}: {row[what]:.2f} instead of {row[limit]:g} ({what})"
        for row in rows
        for what, limit in (("ratio", "limit"), ("one_shot_ratio", "one_shot_limit"), ("part", "part_limit"))
        if row[limit] is not None and row[what] > row[limit]
    ]


class _Timed:
    """Timed case: its plan, traces and durations."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.positions, weights = case.positions()
        self.grid = ImageGrid(case.modes, depth=case.depth)
        geometry = AcquisitionGeometry(
            self.positions,
            case.samples,
            dt=INTERVAL,
            sound_speed=SPEED,
            aperture=case.aperture,
            weights=weights,
        )
        begin = time.perf_counter()
        self.plan = ReconstructionPlan(geometry, self.grid, case.method, compute=CPU)
        self.planned = time.perf_counter() - begin
        shape = len(self.positions), case.samples
        self.traces = np.random.default_rng(1).standard_normal(shape, dtype=np.float32)
        self.acquisition = geometry.acquisition(self.traces)
        self.runs: list[Timing] = []
        self.calls: list[Timing] = []
        self.stages: list[dict[str, float]] = []

    def run(self) -> None:
        """Time one run of the plan, and one complete call of :func:`reconstruct`."""
        clock = _Stages()
        self.runs.append(timed(lambda: self.plan.run(self.traces, progress=clock)))
        self.calls.append(timed(lambda: reconstruct(self.acquisition, self.grid, self.case.method, compute=CPU)))
        self.stages.append(clock.seconds())


def _group(shape: tuple[int, ...], cases: list[_Timed], repeats: int, at_best: Machine) -> list[Row]:
    """Time the cases of one shape and the FFT baselines alternately."""
    bare = fft_pair_baselines(shape, available_threads())
    taken: dict[str, list[Timing]] = {name: [] for name in bare}
    for _ in range(repeats + 1):
        for name, pair in bare.items():
            taken[name].append(timed(pair))
        for case in cases:
            case.run()
    del bare
    yardsticks = {name: _fastest(seconds) for name, seconds in taken.items()}
    name = min(yardsticks, key=lambda name: yardsticks[name].wall)
    whole = _fastest(cases[0].runs).wall
    return [_row(case, name, yardsticks[name], whole, at_best, repeats) for case in cases]


def _fastest(seconds: list[Timing]) -> Timing:
    """Return the minimum wall-clock and processor time, ignoring the first run."""
    return Timing(min(s.wall for s in seconds[1:]), min(s.processor for s in seconds[1:]))


def _row(timed_case: _Timed, name: str, yardstick: Timing, whole: float, at_best: Machine, repeats: int) -> Row:
    case, plan = timed_case.case, timed_case.plan
    tracemalloc.start()
    volume = plan.run(timed_case.traces)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert isinstance(volume, Volume)  # noqa: S101
    run, call = _fastest(timed_case.runs), _fastest(timed_case.calls)
    traffic, arithmetic = lower_bound(plan, at_best)
    row: Row = {
        "case": case.name,
        "method": plan.method,
        "sensors": len(timed_case.positions),
        "shape": "×".join(map(str, plan.geometry.shape)),
        "plan_s": timed_case.planned,
        "run_s": run.wall,
        "run_cpu_s": run.processor,
        "one_shot_s": call.wall,
        "one_shot_cpu_s": call.processor,
        "yardstick": name,
        "yardstick_s": yardstick.wall,
        "yardstick_cpu_s": yardstick.processor,
        "ratio": run.wall / yardstick.wall,
        "cpu_ratio": run.processor / yardstick.processor,
        "limit": case.limit,
        "one_shot_ratio": call.wall / yardstick.wall,
        "one_shot_cpu_ratio": call.processor / yardstick.processor,
        "one_shot_limit": case.one_shot_limit,
        "part": run.wall / whole,
        "part_limit": case.part_limit,
        "error": _error(timed_case, volume),
        "extra_memory": peak / volume.values.nbytes - 1.0,
        "traffic_s": traffic,
        "arithmetic_s": arithmetic,
    }
    row["within"] = not limit_violations([row])
    for stage in timed_case.stages[-1]:
        row[stage.replace(" ", "_") + "_s"] = min(s[stage] for s in timed_case.stages[1:])
    if plan.method == "nedner" and timed_case.positions.ndim == 2 and case.limit is not None:
        row["ned_s"] = row["lateral_transform_s"]
        row["finufft_s"] = _finufft(timed_case.positions, case, min(repeats, 3))
    return row


def _error(timed_case: _Timed, volume: Volume) -> float | None:
    """Return the relative l2 error at random points of the spectrum; None if the image does not contain all of them."""
    g, case = timed_case.plan.geometry, timed_case.case
    if g.record != volume.values.shape[-1] or g.upsampling > 1 or timed_case.plan.method == "linear":
        return None
    rng = np.random.default_rng(3)
    j = np.stack([rng.integers(-(n // 2), (n - 1) // 2 + 1, _POINTS) for n in g.modes], axis=-1)
    l = rng.integers(1, g.samples // 4, _POINTS)  # noqa: E741
    exact = direct_spectrum(
        timed_case.traces, timed_case.positions, j, l, sampling_interval=INTERVAL, sound_speed=SPEED,
        aperture=case.aperture, modes=g.modes, weights=g.weights,
    )  # fmt: skip
    found = _spectrum_at(volume.values, j, l)
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def _spectrum_at(values: NDArray[Any], j: NDArray[np.int64], l: NDArray[np.int64]) -> NDArray[np.complex128]:  # noqa: E741
    """Return the spectrum of an image at some (j, l), by direct sums in float64; point N//2 is x = 0."""
    waves = [
        np.exp(-2j * np.pi / n * np.outer(np.arange(n) - n // 2, j[:, axis]))
        for axis, n in enumerate(values.shape[:-1])
    ]
    depth = np.exp(-2j * np.pi / values.shape[-1] * np.outer(np.arange(values.shape[-1]), l))
    if values.ndim == 2:
        return np.asarray((waves[0] * (values.astype(np.float64) @ depth)).sum(axis=0))
    total = np.zeros(len(l), np.complex128)
    for plane, wave in zip(values, waves[0], strict=True):
        total += wave * (waves[1] * (plane.astype(np.float64) @ depth)).sum(axis=0)
    return total


class _Stages:
    """Progress callback that records the start time of each stage."""

    def __init__(self) -> None:
        self.marks: list[tuple[str, float]] = []

    def __call__(self, stage: str, done: int, total: int) -> None:
        if not self.marks or self.marks[-1][0] != stage:
            self.marks.append((stage, time.perf_counter()))
        self.end = time.perf_counter()

    def seconds(self) -> dict[str, float]:
        ends = [at for _, at in self.marks[1:]] + [self.end]
        return {stage: end - at for (stage, at), end in zip(self.marks, ends, strict=True)}


def _finufft(positions: np.ndarray[Any, Any], case: Case, repeats: int) -> float | None:
    """Return FINUFFT's best time for the same sums: sample pairs as complex vectors, 64 a call, upsampling 1.25.

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
    for threads in {1, available_threads()}:
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
