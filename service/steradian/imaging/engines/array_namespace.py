"""NumPy and CuPy array helpers."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray


def is_gpu_array(values: Any) -> bool:
    """Whether these are an array of a CUDA device, of any library that says so (CuPy, PyTorch, JAX, Numba)."""
    return hasattr(values, "__cuda_array_interface__")


def to_numpy(values: Any) -> NDArray[Any]:
    """NumPy array of an array, wherever it is."""
    if not is_gpu_array(values):
        return np.asarray(values)
    if hasattr(values, "get"):  # CuPy's
        found: NDArray[Any] = values.get()
        return found
    from steradian.imaging.engines.cuda.backend import device

    backend = device()
    return backend.host(backend.array(values))


def like(values: NDArray[Any], other: Any) -> Any:
    """Bring an array to where another one is."""
    return np.asarray(values, like=other) if is_gpu_array(other) else values


def iter_rows(values: Any) -> Iterable[Any]:
    """Return views to be worked on one after the other: rows, which caches hold; of a GPU's array all at once."""
    return (values,) if is_gpu_array(values) else (row[None] for row in values)
