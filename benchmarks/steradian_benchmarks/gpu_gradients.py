"""GPU benchmark of derivatives by sensor positions, time zero and sound speed, compared with bare products and CPU."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from steradian.imaging import AcquisitionGeometry, Compute, ImageGrid
from steradian.imaging.engines.cuda.array_backend import Backend
from steradian.imaging.parametric.models import parametric_forward_model
from steradian.imaging.parametric.transform import TransformAt

DERIVATIVES = ("positions_to_traces", "time_to_traces", "speeds_to_traces")


def gradients_row(
    backend: Backend,
    geometry: AcquisitionGeometry,
    grid: ImageGrid,
    median: Callable[[Backend, Callable[[], object]], float],
    fastest: Callable[[Callable[[], object]], float],
    cpu: Compute,
) -> dict[str, Any]:
    """Time the products of the parametric forward model and its derivatives on device arrays.

    Parameters
    ----------
    backend
        Device.
    geometry, grid
        Of the model.
    median, fastest
        Functions that return the seconds of a call on the device and on the processor.
    cpu
        Execution options of the processor.

    Returns
    -------
    dict
        ``gpu_s``: both bare products; ``positions_to_traces_s``, ``time_to_traces_s``, ``speeds_to_traces_s``: the
        derivatives by all parameters of a kind; ``cpu_s`` of the bare products; ``difference``: largest relative l2
        difference of a derivative from the processor's.
    """
    transforms = [parametric_forward_model(geometry, grid, compute=each) for each in (Compute(device="gpu"), cpu)]
    there, here = (transform.at(transform.parameters()) for transform in transforms)
    rng = np.random.default_rng(1)
    image = rng.standard_normal(transforms[0].volume_shape, dtype=np.float32)
    traces = rng.standard_normal(transforms[0].trace_shape, dtype=np.float32)
    f, g = backend.array(image), backend.array(traces)

    def products(at: TransformAt, image: Any, traces: Any) -> None:
        at.to_traces(image)
        at.to_image(traces)

    row: dict[str, Any] = {"sensors": len(traces), "shape": "×".join(map(str, image.shape))}
    row["gpu_s"] = median(backend, lambda: products(there, f, g))
    row["cpu_s"] = fastest(lambda: products(here, image, traces))
    row["faster"], row["difference"] = row["cpu_s"] / row["gpu_s"], 0.0
    for name in DERIVATIVES:
        row[f"{name}_s"] = median(backend, lambda n=name: getattr(there, n)(f))  # type: ignore[misc]
        found, expected = backend.host(getattr(there, name)(f)), getattr(here, name)(image)
        difference = float(np.linalg.norm(found - expected) / np.linalg.norm(expected))
        row["difference"] = max(row["difference"], difference)
    return row
