"""Speed references of the machine: fastest FFT pair, memory bandwidth, FLOP rate."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steradian.imaging import ReconstructionPlan


class Timing(NamedTuple):
    """Wall-clock time and processor time of all threads together."""

    wall: float
    processor: float


def timed(work: Callable[[], object]) -> Timing:
    """Call a function and return its duration, including the release of its result."""
    wall, processor = time.perf_counter(), time.process_time()
    work()
    return Timing(time.perf_counter() - wall, time.process_time() - processor)


def fft_pair_baselines(shape: tuple[int, ...], threads: int) -> dict[str, Callable[[], object]]:
    """Time a forward and inverse real FFT of a float32 array of this shape with each installed FFT library."""
    from scipy import fft

    array = np.empty(shape, np.float32)
    array[...] = np.random.default_rng(2).standard_normal(shape[-1], dtype=np.float32)
    axes = tuple(range(len(shape)))

    def by_scipy() -> object:
        return fft.irfftn(fft.rfftn(array, workers=threads), shape, workers=threads)

    found: dict[str, Callable[[], object]] = {f"scipy {version('scipy')}": by_scipy}
    try:
        import ducc0
    except ImportError:
        return found

    def by_ducc() -> object:
        there = ducc0.fft.r2c(array, axes=axes, nthreads=threads)
        return ducc0.fft.c2r(there, axes=axes, lastsize=shape[-1], forward=False, inorm=2, nthreads=threads)

    return {f"ducc0 {version('ducc0')}": by_ducc, **found}


class Machine(NamedTuple):
    """Measured machine limits: memory bandwidth of a copy (bytes/s) and FLOP rate of a float32 matrix product."""

    bandwidth: float
    operations: float


def machine_limits(threads: int, *, size: int = 1 << 25) -> Machine:
    """Measure memory bandwidth and FLOP rate on ``threads`` threads, copies of ``size`` numbers; best of five."""
    source, target = np.ones(size, np.float32), np.zeros(size, np.float32)
    parts = list(zip(np.array_split(target, threads), np.array_split(source, threads), strict=True))
    with ThreadPoolExecutor(threads) as pool:

        def copy() -> object:
            return list(pool.map(lambda part: np.copyto(*part), parts))

        copied = min(timed(copy).wall for _ in range(5))
    side = 1024 if size >= 1 << 20 else 128
    matrix: NDArray[Any] = np.ones((side, side), np.float32)
    multiplied = min(timed(lambda: matrix @ matrix).wall for _ in range(5))
    return Machine(2.0 * source.nbytes / copied, 2.0 * side**3 / multiplied)


def lower_bound(plan: ReconstructionPlan, at_best: Machine) -> tuple[float, float]:
    """Return the seconds that a run needs at least for its memory traffic alone, and for its arithmetic alone.

    The modes are written once and read and written twice, the last time as the image. Of the arithmetic the transforms
    count (5 n log2 n each), those over the lateral grid, time, depth and image, and the interpolation of κ.
    """
    tables = plan.tables
    (nx, ny), (mx, my), depths = tables.lateral.grid, tables.lateral.modes, tables.depths
    columns, points, (ix, iy) = mx * (my // 2 + 1), tables.geometry.depth_points, tables.image_modes
    numbers = 5 * plan.output_bytes / at_best.bandwidth
    # two real batches are one complex grid
    lateral = tables.time.samples / 2 * (nx * _flops(ny) + min(ny, my + 1) * _flops(nx))
    image = depths / 2 * (min(iy, my + 1) * _flops(ix) + ix * _flops(iy))
    taps = len(tables.time.taps)
    depth = columns * (_flops(tables.time.length) + _flops(points) + points * 4 * taps)
    return numbers, (lateral + depth + image) / at_best.operations


def _flops(size: float) -> float:
    return 5 * size * math.log2(size) if size > 1 else 0.0
