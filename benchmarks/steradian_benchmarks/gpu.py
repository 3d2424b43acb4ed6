"""GPU benchmark: direct reconstruction, forward model and iterative fit, compared with FFT, other engines and CPU."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from steradian.benchmarks.speed_cases import INTERVAL, SPEED, YARN
from steradian.core.progress import Progress
from steradian.imaging import (
    AcquisitionGeometry,
    Compute,
    ImageGrid,
    ReconstructionPlan,
    Volume,
    direct_spectrum,
    spectrum_of,
)
from steradian.imaging.engines.cuda.array_backend import Backend, device
from steradian.imaging.engines.cuda.engine import CudaEngine
from steradian.imaging.operators import ForwardOperator
from steradian.masks import equi_steradian_mask
from steradian_benchmarks.gpu_gradients import gradients_row
from steradian_benchmarks.gpu_reference_libraries import cufinufft_row, patminton_row

Row: TypeAlias = dict[str, Any]
LIMIT, FASTER, FIT_SECONDS = 1.5, 15.0, 1.0
"""Transform pairs that a direct image may take, how many times faster than two processors it should be, and what a fit
may take."""
_POINTS = 24  # of the spectrum, that are compared with direct sums
_PROCESSORS = 2
GPU, CPU = Compute(device="gpu"), Compute(device="cpu", threads=_PROCESSORS)


def gpu(*, quick: bool = False, repeats: int = 20, only: str = "", progress: Progress | None = None) -> list[Row]:
    """Run the reconstruction benchmark on the current CUDA device.

    Parameters
    ----------
    quick
        Tiny volumes: whether it runs, no measurement.
    repeats
        Runs of each; the median counts. Two more come first.
    only
        Leave out rows whose case does not begin so.
    progress
        Called before each part.

    Returns
    -------
    list of dict
        One row each. ``gpu_s``: arrays on the device, from call to the end of all that it started; ``memory_s``: the
        same from and to NumPy's arrays, of which ``up_s`` and ``down_s`` are transfers. ``pair_s``: cuFFT's real
        transforms of the image there and back, ``ratio`` to it. ``cpu_s``: the engine of the processor on two threads,
        ``faster`` than that. ``difference``: relative l2 from the processor's image; ``error``: of the spectrum from
        direct float64 sums.

    Raises
    ------
    InvalidInput
        If there is no GPU: it names what is missing.
    """
    backend = device()
    sizes = [(6, 16)] if quick else [(226, 1024), (452, 1024)]
    few, many = (30, 40) if quick else (1600, 51_076)
    parts: list[tuple[str, Callable[[], Row]]] = []
    for modes, samples in sizes:
        parts.append((f"direct {modes}", lambda m=modes, n=samples: _direct(backend, m, n, few, repeats)))  # type: ignore[misc]
    modes, samples = sizes[0]
    parts += [
        ("direct, as many anywhere", lambda: _direct(backend, modes, samples, many, repeats, anywhere=True)),
        ("model", lambda: _model(backend, modes, samples, few, repeats, "forward")),
        ("adjoint", lambda: _model(backend, modes, samples, few, repeats, "backward")),
        ("gradients", lambda: _gradients(backend, modes, samples, few, repeats)),
        ("lateral step", lambda: _stages(backend, modes, samples, few, repeats)),
        ("cuFINUFFT", lambda: cufinufft_row(backend, sensors(few), modes, samples, repeats, median)),
        ("PATminton", lambda: patminton_row(backend, sensors(few), 64, 128, repeats, median)),
        ("PATminton's size", lambda: _direct(backend, 64, 128, few, repeats)),
        ("fit", lambda: _fit(quick)),
    ]
    if quick:  # what only a device can do, and the size of others
        parts = [part for part in parts if part[0] not in ("PATminton", "PATminton's size")]
    chosen = [part for part in parts if part[0].startswith(only)]
    rows = []
    for i, (name, part) in enumerate(chosen):
        if progress is not None:
            progress(name, i, len(chosen))
        rows.append({"case": name, "device": backend.name, **part()})
        backend.release()
    if progress is not None:
        progress("done", len(chosen), len(chosen))
    return rows


def limit_violations(rows: list[Row]) -> list[str]:
    """Return a message for each measurement that exceeds its limit."""
    found = [f"{r['case']}: {r['ratio']:.2f} pairs instead of {LIMIT:g}" for r in rows if r.get("ratio", 0) > LIMIT]
    found += [
        f"{r['case']}: {r['faster']:.1f} times faster instead of {FASTER:g}"
        for r in rows
        if r.get("faster", FASTER) < FASTER and r["case"].startswith("direct")
    ]
    slow = [r["fit_s"] for r in rows if r.get("fit_s", 0) > FIT_SECONDS]
    return found + [f"fit: {seconds:.2f} s instead of {FIT_SECONDS:g}" for seconds in slow]


def sensors(count: int, *, anywhere: bool = False) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Return sensor positions and weights: the paper's mask, or random points over the whole aperture."""
    if anywhere:
        return (np.random.default_rng(0).random((count, 2)) - 0.5) * YARN, np.full(count, YARN**2 / count)
    mask = equi_steradian_mask(YARN, 3.6e-3, count)
    return np.asarray(mask.positions, np.float64), np.asarray(mask.weights, np.float64)


def median(backend: Backend, work: Callable[[], object], repeats: int) -> float:
    """Return the median duration in seconds of a call, including the GPU work that it starts."""
    taken = []
    for _ in range(repeats + 2):
        backend.wait()
        begin = time.perf_counter()
        found = work()
        backend.wait()
        taken.append(time.perf_counter() - begin)
        del found
    return float(np.median(taken[2:]))


def _geometry(
    positions: NDArray[np.float64], samples: int, weights: NDArray[np.float64] | None = None
) -> AcquisitionGeometry:
    return AcquisitionGeometry(positions, samples, dt=INTERVAL, sound_speed=SPEED, aperture=YARN, weights=weights)


def _traces(count: int, samples: int) -> NDArray[np.float32]:
    return np.random.default_rng(1).standard_normal((count, samples), dtype=np.float32)


def _direct(backend: Backend, modes: int, samples: int, count: int, repeats: int, *, anywhere: bool = False) -> Row:
    positions, weights = sensors(count, anywhere=anywhere)
    geometry, grid = _geometry(positions, samples, weights), ImageGrid(modes)
    traces = _traces(len(positions), samples)
    plan = ReconstructionPlan(geometry, grid, compute=GPU)
    there, image = backend.array(traces), backend.array(np.zeros(plan.geometry.shape, np.float32))
    row: Row = {"sensors": len(positions), "shape": "×".join(map(str, plan.geometry.shape))}
    row["gpu_s"] = median(backend, lambda: _made(plan, there), repeats)
    row["pair_s"] = median(backend, lambda: _fft_pair(backend, image), repeats)
    row["ratio"] = row["gpu_s"] / row["pair_s"]
    row["memory_s"] = median(backend, lambda: plan.run(traces), max(3, repeats // 4))
    row["up_s"] = median(backend, lambda: backend.array(traces), repeats)
    row["down_s"] = median(backend, lambda: backend.host(image), max(3, repeats // 4))
    row["device_bytes"] = plan.engine.room.device_bytes  # type: ignore[union-attr]
    found = plan.run(traces)
    assert isinstance(found, Volume)
    again = plan.run(traces)
    assert isinstance(again, Volume)
    row["same_bits"] = bool((found.values == again.values).all())
    j, l = _some(plan)  # noqa: E741
    exact = direct_spectrum(
        traces, positions, j, l, sampling_interval=INTERVAL, sound_speed=SPEED, aperture=YARN, modes=modes,
        weights=plan.geometry.weights,
    )  # fmt: skip
    row["error"] = float(np.linalg.norm(spectrum_of(found.values, j, l) - exact) / np.linalg.norm(exact))
    here = ReconstructionPlan(geometry, grid, compute=CPU)
    volume = here.run(traces)
    assert isinstance(volume, Volume)
    row["difference"] = _time_steps(found.values, volume.values)
    row["cpu_s"] = _fastest(lambda: here.run(traces))
    row["faster"] = row["cpu_s"] / row["gpu_s"]
    return row


def _made(plan: ReconstructionPlan, traces: Any) -> Any:
    engine = plan.engine
    assert isinstance(engine, CudaEngine)
    return engine.to_image(engine.to_depth(engine.lateral(traces)))


def _fft_pair(backend: Backend, image: Any) -> Any:
    # norm "forward" on the way back: bare transforms, without a pass that scales
    return backend.fft.irfftn(backend.fft.rfftn(image), image.shape, overwrite_x=True, norm="forward")


def _some(plan: ReconstructionPlan) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return random indices of the spectrum."""
    rng, g = np.random.default_rng(3), plan.geometry
    j = np.stack([rng.integers(-(n // 2), (n - 1) // 2 + 1, _POINTS) for n in g.modes], axis=-1)
    return j, rng.integers(1, g.samples // 4, _POINTS)


def _model(backend: Backend, modes: int, samples: int, count: int, repeats: int, way: str) -> Row:
    """Time the forward model and its adjoint for a periodic medium, whose volume is the image's."""
    positions, _ = sensors(count)
    geometry, grid = _geometry(positions, samples), ImageGrid(modes, lateral_padding=1.0)
    there, here = (ForwardOperator(geometry, grid, compute=each) for each in (GPU, CPU))
    shape = there.volume_shape if way == "forward" else there.trace_shape
    given = np.random.default_rng(1).standard_normal(shape, dtype=np.float32)
    engine = there.engine
    assert isinstance(engine, CudaEngine)
    moved = engine.array(given)

    def work() -> Any:
        if way == "forward":
            return engine.lateral_adjoint(engine.to_depth_adjoint(engine.to_image_adjoint(moved)))
        return engine.to_image(engine.to_depth(engine.lateral(moved)))

    product: Any = getattr(here, way)
    row: Row = {"sensors": len(positions), "shape": "×".join(map(str, there.volume_shape))}
    row["gpu_s"] = median(backend, work, repeats)
    row["difference"] = _time_steps(engine.host(work()), product(given))
    row["cpu_s"] = _fastest(lambda: product(given))
    row["faster"] = row["cpu_s"] / row["gpu_s"]
    return row


def _gradients(backend: Backend, modes: int, samples: int, count: int, repeats: int) -> Row:
    geometry, grid = _geometry(sensors(count)[0], samples), ImageGrid(modes, lateral_padding=1.0)
    return gradients_row(backend, geometry, grid, partial(median, repeats=repeats), _fastest, CPU)


def _stages(backend: Backend, modes: int, samples: int, count: int, repeats: int) -> Row:
    """Time the stages of the reconstruction and their components separately.

    ``gpu_s`` is the lateral step; ``grid_fft_s`` its transforms, with frequencies innermost as they are, and
    ``grid_fft_outermost_s`` with these outermost.
    """
    xp, fft = backend.xp, backend.fft
    positions, weights = sensors(count)
    plan = ReconstructionPlan(_geometry(positions, samples, weights), ImageGrid(modes), compute=GPU)
    engine = plan.engine
    assert isinstance(engine, CudaEngine)
    there = backend.array(_traces(len(positions), samples))
    over_time = engine.lateral(there)
    row: Row = {"sensors": len(positions), "shape": "×".join(map(str, over_time.shape))}
    row["gpu_s"] = median(backend, lambda: engine.lateral(there), repeats)
    row["to_depth_s"] = median(backend, lambda: engine.to_depth(over_time), repeats)
    over_depth = engine.to_depth(over_time)
    row["to_image_s"] = median(backend, lambda: engine.to_image(over_depth), repeats)
    grid = xp.zeros(over_time.shape, over_time.dtype)
    row["grid_fft_s"] = median(backend, lambda: fft.fftn(grid, axes=(0, 1), overwrite_x=True), repeats)
    turned = xp.zeros((grid.shape[2], *grid.shape[:2]), grid.dtype)
    row["grid_fft_outermost_s"] = median(backend, lambda: fft.fftn(turned, axes=(1, 2), overwrite_x=True), repeats)
    row["turning_s"] = median(backend, lambda: xp.ascontiguousarray(xp.moveaxis(grid, 2, 0)), repeats)
    row["copied_bytes_per_s"] = 2 * grid.nbytes / median(backend, grid.copy, repeats)
    return row


def _fit(quick: bool) -> Row:
    """Reconstruct the paper's yarn by iterative soft thresholding on CPU or GPU; return time and correlation."""
    from steradian import phantoms, quality
    from steradian.imaging import reconstruct
    from steradian_benchmarks.paper.iterative_measurements import SMALL, Scenario

    scene = SMALL if quick else Scenario()
    mask = equi_steradian_mask(scene.aperture, scene.depth, 20 if quick else scene.points, weighting="analytic")
    balls, traces = scene.record(mask.positions, 0)
    acquisition, grid = scene.acquisition(traces, mask.positions), scene.grid
    grid = replace(grid, modes=6, lateral_padding=1.0) if quick else grid
    row: Row = {"sensors": mask.count}
    for name, compute in (("fit", GPU), ("cpu", CPU)):
        taken = []
        for _ in range(1 if quick else 3):
            begin = time.perf_counter()
            volume = reconstruct(acquisition, grid, scene.options, compute=compute)
            taken.append(time.perf_counter() - begin)
            if name == "cpu":
                break
        axes, info = volume.axes, volume.info
        assert axes.y is not None and info is not None  # noqa: PT018
        truth = phantoms.initial_pressure(balls, axes.x, axes.y, axes.z)
        row[f"{name}_s"] = min(taken)
        row[f"{name}_products"] = info.products
        row[f"{name}_correlation"] = quality.correlation(volume.values, truth)
        row["shape"] = "×".join(map(str, volume.values.shape))
    row["faster"] = row["cpu_s"] / row["fit_s"]
    return row


def _fastest(work: Callable[[], object], repeats: int = 2) -> float:
    taken = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        taken.append(time.perf_counter() - begin)
    return min(taken)


def _time_steps(found: NDArray[Any], expected: NDArray[Any]) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))
