"""Reconstructions with flat keyword arguments, for tests that vary one of many.

Keywords have the names of requests and scan files (``sampling_interval``, ``time_zero``, ``depth_range``,
``highest_frequency``), as the test phantoms have. The device is the CPU unless ``device`` is given.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from steradian.imaging import (
    AcquisitionGeometry,
    Compute,
    ImageGrid,
    Iterative,
    Method,
    ReconstructionPlan,
    Volume,
    reconstruct,
)
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.options import DIRECT_METHODS

GEOMETRY = {
    "sampling_interval": "dt",
    "sound_speed": "sound_speed",
    "time_zero": "t0",
    "weights": "weights",
    "aperture": "aperture",
    "wrap": "wrap",
}
GRID = {
    "depth_range": "depth",
    "depth_step": "depth_step",
    "upsampling": "upsampling",
    "lateral_padding": "lateral_padding",
    "time_padding": "time_padding",
}
DIRECT = {
    "tolerance": "tolerance",
    "window": "window",
    "highest_frequency": "max_frequency",
    "correction": "correction",
}
COMPUTE = ("device", "dtype", "threads", "memory_limit", "device_memory")


def taken(flat: dict[str, Any], names: dict[str, str]) -> dict[str, Any]:
    """Remove some keywords and return them under the library's names."""
    return {library: flat.pop(name) for name, library in names.items() if name in flat}


def flat_geometry(positions: Any, samples: int, flat: dict[str, Any]) -> AcquisitionGeometry:
    """Remove the keywords of an acquisition and return its geometry."""
    return AcquisitionGeometry(positions, samples, **taken(flat, GEOMETRY))


def flat_grid(flat: dict[str, Any]) -> ImageGrid:
    """Remove the keywords of an image grid and return that."""
    return ImageGrid(flat.pop("modes"), **taken(flat, GRID))


def flat_compute(flat: dict[str, Any]) -> Compute:
    """Remove the keywords of execution and return its options."""
    return Compute(**{"device": "cpu", **{name: flat.pop(name) for name in COMPUTE if name in flat}})


def flat_method(flat: dict[str, Any]) -> Method:
    """Remove the keywords of a method and return that."""
    name, options = flat.pop("method", "nedner"), flat.pop("iterative", None)
    if name == "iterative":
        return replace(options or Iterative(), **taken(flat, {each: each for each in ("tolerance", "correction")}))
    return DIRECT_METHODS[name](**taken(flat, DIRECT))


def flat_reconstruct(
    traces: Any, positions: Any, *, scale: float = 1.0, progress: Any = None, cancelled: Any = None, **flat: Any
) -> Volume:
    """Reconstruct as :func:`steradian.reconstruct` does."""
    geometry, grid, compute, method = (
        flat_geometry(positions, 4, flat),
        flat_grid(flat),
        flat_compute(flat),
        flat_method(flat),
    )
    require_all(flat)
    acquisition = geometry.acquisition(traces, scale=scale)
    return reconstruct(acquisition, grid, method, compute=compute, progress=progress, cancelled=cancelled)


def flat_fit(traces: Any, positions: Any, *, options: Iterative | None = None, **flat: Any) -> Volume:
    """Reconstruct iteratively."""
    return flat_reconstruct(traces, positions, method="iterative", iterative=options, **flat)


def flat_plan(positions: Any, *, samples: int, **flat: Any) -> ReconstructionPlan:
    """Create a plan as :class:`steradian.ReconstructionPlan` does."""
    geometry, grid, compute, method = (
        flat_geometry(positions, samples, flat),
        flat_grid(flat),
        flat_compute(flat),
        flat_method(flat),
    )
    require_all(flat)
    return ReconstructionPlan(geometry, grid, method, compute=compute)  # type: ignore[arg-type]


def flat_operator(positions: Any, *, samples: int, **flat: Any) -> ForwardOperator:
    """Create a forward model as :class:`steradian.ForwardOperator` does."""
    geometry, grid, compute = flat_geometry(positions, samples, flat), flat_grid(flat), flat_compute(flat)
    if "highest_frequency" in flat:
        flat["max_frequency"] = flat.pop("highest_frequency")
    return ForwardOperator(geometry, grid, compute=compute, **flat)


def require_all(flat: dict[str, Any]) -> None:
    """Raise :class:`TypeError` for keywords that are left."""
    if flat:
        raise TypeError(f"unknown keywords: {', '.join(flat)}")
