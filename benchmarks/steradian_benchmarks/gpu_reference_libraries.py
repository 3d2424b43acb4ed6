"""Timings of the libraries cuFINUFFT and PATminton on the same GPU, as references."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.benchmarks.speed_cases import INTERVAL, SPEED, YARN
from steradian.imaging.engines.cuda.array_backend import Backend

Median = Callable[[Backend, Callable[[], object], int], float]
Sensors = tuple[NDArray[np.float64], NDArray[np.float64] | None]
_VECTORS = 64  # that cuFINUFFT transforms at a time


def cufinufft_row(
    backend: Backend, given: Sensors, modes: int, samples: int, repeats: int, median: Median
) -> dict[str, Any]:
    """Time cuFINUFFT for the lateral NUFFT: pairs of samples as complex vectors, by its fastest method and grid."""
    row: dict[str, Any] = {"peer": _named("cufinufft")}
    try:
        cufinufft: Any = importlib.import_module("cufinufft")
    except (ImportError, OSError, RuntimeError) as error:
        return row | {"why_not": str(error)}
    xp = backend.xp
    x, y = (xp.ascontiguousarray(xp.asarray(2 * np.pi * line / YARN, np.float32)) for line in given[0].T)
    vectors = min(_VECTORS, samples // 2)
    data = xp.ones((vectors, len(x)), np.complex64)
    out = xp.empty((vectors, modes, modes), np.complex64)
    taken: dict[str, float] = {}
    for method in (1, 2):
        for upsampling in (1.25, 2.0):
            try:
                plan = cufinufft.Plan(
                    1, (modes, modes), n_trans=vectors, eps=1e-4, isign=-1, dtype="complex64", gpu_method=method,
                    upsampfac=upsampling,
                )  # fmt: skip
                plan.setpts(x, y)

                def run(plan: Any = plan) -> None:
                    for _ in range(-(-samples // 2 // vectors)):
                        plan.execute(data, out)

                taken[f"method {method}, upsampling {upsampling:g}"] = median(backend, run, repeats)
            except (RuntimeError, ValueError, TypeError) as error:
                row[f"method {method}, upsampling {upsampling:g}"] = str(error)
    if not taken:
        return row | {"why_not": "none of its methods ran"}
    best = min(taken, key=lambda name: taken[name])
    return row | {"gpu_s": taken[best], "setting": best, "sensors": len(x), "all": taken}


def patminton_row(
    backend: Backend, given: Sensors, modes: int, samples: int, repeats: int, median: Median
) -> dict[str, Any]:
    """Time PATminton's forward and adjoint products (float64) of a small volume; cost is sensors × voxels."""
    row: dict[str, Any] = {"peer": _named("patminton")}
    try:
        torch: Any = importlib.import_module("torch")
        patminton: Any = importlib.import_module("patminton")
        positions = np.concatenate([given[0], np.zeros((len(given[0]), 1))], axis=1)
        depth = samples * SPEED * INTERVAL
        positions[:, 2] = -depth / 2  # its grid is centred on the origin
        operator = patminton.PAT(
            modes, modes, samples, YARN / 2, YARN / 2, depth / 2, samples, 0.0, INTERVAL, SPEED, mode="points",
            locPoints=np.ascontiguousarray(positions[:, None, :]), area=np.ones((len(positions), 1)),
            laser_pulse_variance=0.0,
        )  # fmt: skip
        volume = torch.rand((modes, modes, samples), device="cuda", dtype=torch.float64)
        traces = torch.rand((len(positions), samples), device="cuda", dtype=torch.float64)
        few = max(3, repeats // 4)
        row["forward_s"] = median(backend, lambda: operator.PMV(volume, traces), few)
        row["gpu_s"] = median(backend, lambda: operator.PMVT(volume, traces), few)
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        return row | {"why_not": str(error).splitlines()[0]}
    return row | {"sensors": len(positions), "shape": f"{modes}×{modes}×{samples}"}


def _named(distribution: str) -> str:
    try:
        return f"{distribution} {version(distribution)}"
    except PackageNotFoundError:
        return f"{distribution}, not installed"
