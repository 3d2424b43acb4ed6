"""Relative error of the image's spectrum against direct float64 sums."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from steradian.core.progress import Progress
from steradian.imaging import (
    Acquisition,
    Compute,
    DirectMethod,
    ImageGrid,
    LinearKappa,
    NearestKappa,
    Nufft,
    direct_spectrum,
    kaiser_bessel,
    reconstruct,
    spectrum_of,
)

Row: TypeAlias = dict[str, Any]
_SIDE, _INTERVAL = 0.01, 8e-9


def accuracy(*, points: int = 300, progress: Progress | None = None) -> list[Row]:
    """Measure the error of the image's spectrum for several tolerances, windows, methods and sizes.

    Parameters
    ----------
    points
        Random (j, l) compared a row, a tenth of them with the smallest κ.
    progress
        Called before each row.

    Returns
    -------
    list of dict
        ``sensors``, ``modes``, ``samples``, ``method``, ``tolerance``, ``window``, ``dtype`` and ``error``, the
        relative l2 error. Linear and nearest interpolation of κ have no tolerance to keep: theirs is their own error.
    """
    settings: list[Row] = []
    for modes, samples in (((64, 64), 256), ((45, 51), 255), ((512,), 512)):
        size = {"modes": modes, "samples": samples}
        for tolerance in (1e-3, 1e-4, 1e-5, 1e-6):
            settings.append({**size, "sensors": "anywhere", "method": Nufft(tolerance=tolerance)})
        for tolerance in (1e-4, 1e-6):
            settings.append({**size, "sensors": "grid", "method": Nufft(tolerance=tolerance)})
        for method in (LinearKappa(), NearestKappa()):
            settings.append({**size, "sensors": "grid", "method": method})
    paper = {"modes": (64, 64), "samples": 256, "sensors": "anywhere"}
    settings.append({**paper, "method": Nufft(window="semicircle")})
    settings.append({**paper, "method": Nufft(window=kaiser_bessel(6, 2.0))})
    settings.append({**paper, "method": Nufft(tolerance=1e-10, window=kaiser_bessel(6, 2.0)), "dtype": "float64"})
    rows = []
    for i, setting in enumerate(settings):
        if progress is not None:
            progress("accuracy", i, len(settings))
        rows.append(_row(points=points, **setting))
    if progress is not None:
        progress("accuracy", len(settings), len(settings))
    return rows


def _positions(sensors: str, modes: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float64]:
    if sensors == "grid":
        axes = [(np.arange(n) - n // 2) * _SIDE / n for n in modes]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(modes))
    return (rng.random((1000, len(modes))) - 0.5) * _SIDE


@dataclass(frozen=True, eq=False)
class _Case:
    """Test case: random traces (M, N_t), other inputs, and the exact spectrum at some indices j (K, d), l (K,)."""

    traces: NDArray[np.float64]
    positions: NDArray[np.float64]
    common: Row
    j: NDArray[np.int64]
    depth: NDArray[np.int64]
    exact: NDArray[np.complex128]


@lru_cache(maxsize=1)
def _case(modes: tuple[int, ...], samples: int, sensors: str, points: int) -> _Case:
    """Return a cached test case, because consecutive rows share a case and its direct sums take most of the time."""
    rng = np.random.default_rng(0)
    positions = _positions(sensors, modes, rng)
    traces = rng.standard_normal((len(positions), samples))
    common: Row = {
        "sampling_interval": _INTERVAL,
        "sound_speed": 0.9 * _SIDE / (samples * _INTERVAL),
        "aperture": _SIDE,
        "modes": modes,
    }
    j = np.stack([rng.integers(-(n // 2), (n - 1) // 2 + 1, points) for n in modes], axis=-1)
    depth = rng.integers(1, (samples + 1) // 2, points)
    near = points // 10
    j[:near], depth[:near] = np.sign(j[:near]), 1
    return _Case(traces, positions, common, j, depth, direct_spectrum(traces, positions, j, depth, **common))


def _row(
    *, modes: tuple[int, ...], samples: int, sensors: str, points: int, method: DirectMethod, dtype: str | None = None
) -> Row:
    case = _case(modes, samples, sensors, points)
    timing = {"dt": case.common["sampling_interval"], "sound_speed": case.common["sound_speed"]}
    acquisition = Acquisition(case.traces, case.positions, aperture=_SIDE, **timing)
    volume = reconstruct(acquisition, ImageGrid(modes), method, compute=Compute(device="cpu", dtype=dtype))
    found = spectrum_of(volume.values, case.j, case.depth)
    window, direct = method.window, isinstance(method, Nufft)
    return {
        "sensors": sensors,
        "modes": "×".join(map(str, modes)),
        "samples": samples,
        "method": method.name if sensors != "grid" or not direct else "ner",
        "tolerance": method.tolerance if direct else None,
        "window": window if isinstance(window, str) else f"K={window.width // 2}, c={window.oversampling:g}",
        "dtype": volume.values.dtype.name,
        "error": float(np.linalg.norm(found - case.exact) / np.linalg.norm(case.exact)),
    }
