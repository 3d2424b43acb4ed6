"""Measurements of the section on iterative reconstruction: volumes from 3 % of a scan's points, against the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian import phantoms, quality
from steradian.benchmarks.machine_limits import timed
from steradian.core.exceptions import InvalidInput
from steradian.imaging import (
    Acquisition,
    Compute,
    Conditioning,
    ImageGrid,
    Iterative,
    ReconstructionPlan,
    Volume,
    reconstruct,
)
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.signal.bandwidth import signal_band
from steradian.masks import equi_steradian_mask
from steradian_benchmarks.paper.pictures import figure, save, show
from steradian_benchmarks.paper.sections import SectionContext, SectionResult

KWAVE = Path(__file__).parents[3] / "tests" / "data" / "yarn_kwave_sparse.npz"
"""k-Wave's yarn, in the checkout that this file is part of."""
CPU = Compute(device="cpu")
DIRECT, FILTERED, ITERATIVE = "direct", "direct, low-passed", "iterative"


@dataclass(frozen=True, slots=True)
class Scenario:
    """Parameters of the experiment in SI units: the paper's by default, smaller ones for a quick test."""

    aperture: float = 13.56e-3
    depth: float = 3.6e-3
    points: int = 1605
    radius: float = 3.0e-3
    modes: int = 226
    samples: int = 1024
    interval: float = 8e-9
    shown: tuple[float, float] = (1.2e-3, 6.0e-3)
    speed: float = 1480.0
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    options: Iterative = field(default_factory=Iterative)
    repeats: int = 5

    @property
    def grid(self) -> ImageGrid:
        """Voxel grid of all images of the scenario."""
        return ImageGrid(self.modes, depth=self.shown)

    def acquisition(
        self, traces: NDArray[Any], where: NDArray[Any], weights: NDArray[Any] | None = None
    ) -> Acquisition:
        """Return the acquisition of A-lines (M, N_t) at positions (M, 2) in metres."""
        return Acquisition(
            traces,
            where,
            dt=self.interval,
            sound_speed=self.speed,
            aperture=self.aperture,
            weights=weights,
        )

    def record(self, where: NDArray[Any], seed: int) -> tuple[phantoms.Balls, NDArray[np.float32]]:
        """Return a simulated yarn and its A-lines with noise."""
        balls = phantoms.yarn(seed, centre=(0.0, 0.0, self.depth), radius=self.radius)
        clean = phantoms.pressure(
            balls, where, samples=self.samples, sampling_interval=self.interval, sound_speed=self.speed
        )
        return balls, phantoms.add_noise(clean, 30.0, convention="peak", seed=seed)


SMALL = Scenario(
    5.04e-3, 1.4e-3, 222, 1.1e-3, 84, 420, 10e-9, (0.3e-3, 2.7e-3), 1480.0, (0,), Iterative(iterations=3), 1
)


def measure(run: SectionContext) -> SectionResult:
    """Reconstruct yarns of several seeds, and k-Wave's yarn, with direct and iterative methods."""
    scene = SMALL if run.quick else Scenario()
    if not run.quick and not KWAVE.exists():
        raise InvalidInput("only", "iterative", f"a checkout, which has k-Wave's yarn as {KWAVE}; or --quick")
    mask = equi_steradian_mask(scene.aperture, scene.depth, scene.points, weighting="analytic")
    total = len(scene.seeds) + 2
    rows = []
    for done, seed in enumerate(scene.seeds):
        run.step(done, total)
        rows.append(_yarn(run, scene, mask.positions, mask.weights, seed))
    run.step(total - 2, total)
    kwave = None if run.quick else _kwave()
    run.step(total - 1, total)
    cost = _cost(scene, mask.positions, mask.weights)
    run.step(total, total)
    options = scene.options
    return {
        "points": mask.count,
        "modes": scene.modes,
        "samples": scene.samples,
        "speed": scene.speed,
        "depths": list(scene.shown),
        "noise_db": 30.0,
        "options": {
            "regularisation": options.regularisation,
            "strength": options.lambda_(),
            "iterations": options.iterations,
            "non_negative": options.non_negative,
        },
        "rows": rows,
        "kwave": kwave,
        "cost": cost,
    }


def _yarn(run: SectionContext, scene: Scenario, where: NDArray[Any], weights: NDArray[Any], seed: int) -> SectionResult:
    balls, traces = scene.record(where, seed)
    images = _images(scene.acquisition(traces, where, weights), scene.grid, scene.options)
    axes = images[DIRECT].axes
    assert axes.y is not None
    truth = phantoms.initial_pressure(balls, axes.x, axes.y, axes.z)
    if seed == scene.seeds[0]:
        _draw(run, images, truth)
    figures = {name: _figures(image.values, truth) for name, image in images.items()}
    return {"seed": seed, "images": figures, **_about(images[ITERATIVE])}


def _images(acquisition: Acquisition, grid: ImageGrid, options: Iterative) -> dict[str, Volume]:
    plan = ReconstructionPlan(acquisition.geometry, grid, compute=CPU)
    traces = np.asarray(acquisition.traces)
    highest, _ = signal_band(traces, acquisition.dt)
    passed = Conditioning(band=(0.0, highest)).apply(traces, sampling_interval=acquisition.dt)
    fitted = reconstruct(acquisition, grid, options, compute=CPU)
    direct, low = plan.run(traces), plan.run(passed)
    assert isinstance(direct, Volume) and isinstance(low, Volume)  # noqa: PT018
    return {DIRECT: direct, FILTERED: low, ITERATIVE: fitted}


def _figures(values: NDArray[Any], truth: NDArray[Any]) -> SectionResult:
    return {
        "volume": quality.correlation(values, truth),
        "mip": quality.correlation(values.max(axis=2), truth.max(axis=2)),
        "amplitude": float(np.vdot(values, truth) / np.vdot(truth, truth)),
    }


def _about(volume: Volume) -> SectionResult:
    info = volume.info
    assert info is not None
    return {
        "iterations": info.iterations,
        "stopped": info.stop_reason,
        "products": info.products,
        "thinning": info.decimation,
        "megabytes": info.memory_bytes / 1e6,
        "outputs": info.memory_bytes / volume.values.nbytes,
    }


def _kwave() -> SectionResult:
    """Reconstruct k-Wave's yarn and compare on k-Wave's voxels, whose depths lie between ours."""
    with np.load(KWAVE) as file:
        data = dict(file)
    pitch, interval, speed = (float(data[name]) for name in ("dx", "dt", "c"))
    truth = data["p0"].astype(np.float32)
    side = truth.shape[0]
    traces = data["traces"].astype(np.float32) * float(data["scale"])
    noise = np.random.default_rng(0).standard_normal(traces.shape, np.float32)
    traces += np.float32(data["noise_std"]) * noise
    where = (data["sensors"].astype(np.float64) - side // 2) * pitch
    weights = np.hypot(np.linalg.norm(where, axis=1), 3.2e-3) ** 3
    weights *= (side * pitch) ** 2 / weights.sum()
    depths = np.arange(truth.shape[2]) * pitch
    acquisition = Acquisition(traces, where, dt=interval, sound_speed=speed, aperture=side * pitch, weights=weights)
    grid = ImageGrid(side, depth=(0.0, float(depths[-1]) + 2 * speed * interval))
    images = _images(acquisition, grid, Iterative())
    figures = {}
    for name, image in images.items():
        place = depths / (speed * interval)
        below = np.floor(place + 1e-9).astype(int)
        share = (place - below).astype(np.float32)
        figures[name] = _figures(image.values[:, :, below] * (1 - share) + image.values[:, :, below + 1] * share, truth)
    return {"points": len(where), "of": side**2, "images": figures, **_about(images[ITERATIVE])}


def _cost(scene: Scenario, where: NDArray[Any], weights: NDArray[Any]) -> SectionResult:
    """Time products with the model and a whole iterative run, in units of one direct reconstruction.

    The least of the repeats, which other work on the machine disturbs least.
    """
    traces = np.random.default_rng(0).standard_normal((len(where), scene.samples), np.float32)
    geometry, grid = scene.acquisition(traces, where, weights).geometry, ImageGrid(scene.modes)
    plan, operator = ReconstructionPlan(geometry, grid, compute=CPU), ForwardOperator(geometry, grid, compute=CPU)
    volume = np.asarray(operator.backward(traces))
    works: dict[str, Callable[[], object]] = {
        "direct": lambda: plan.run(traces),
        "forward": lambda: operator.forward(volume),
        "backward": lambda: operator.backward(traces),
    }
    times = {name: [timed(work) for _ in range(scene.repeats + 1)][1:] for name, work in works.items()}
    sound = scene.acquisition(scene.record(where, 0)[1], where)
    results: list[Volume] = []
    runs = []
    for _ in range(scene.repeats):
        runs.append(timed(lambda: results.append(reconstruct(sound, scene.grid, scene.options, compute=CPU))))
        times["direct"].append(timed(works["direct"]))
    unit = {name: min(seconds.wall for seconds in taken) for name, taken in times.items()}
    return {
        "direct_s": unit["direct"],
        "forward": unit["forward"] / unit["direct"],
        "backward": unit["backward"] / unit["direct"],
        "run": min(seconds.wall for seconds in runs) / unit["direct"],
        "run_cpu": min(seconds.processor for seconds in runs) / min(seconds.processor for seconds in times["direct"]),
        "products": _about(results[0])["products"],
    }


def _draw(run: SectionContext, images: dict[str, Volume], truth: NDArray[Any]) -> None:
    some = images[DIRECT]
    axes = some.axes
    assert axes.y is not None
    values = {"truth": truth, **{name: image.values for name, image in images.items() if name != FILTERED}}
    made, panels = figure(9.6, 6.4, 2, 3)
    middle = len(axes.y) // 2
    for column, (name, volume) in enumerate(values.items()):
        show(panels[column], volume.max(axis=2), axes.x, axes.y, f"{name}: z-projection")
        show(panels[3 + column], volume[:, middle], axes.x, axes.z, f"{name}: the plane y = 0", plane="xz")
    save(made, run.picture("iterative"))
