"""Helper functions for NumPy and CuPy arrays."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray


def is_gpu_array(values: Any) -> bool:
    """Return whether a value is an array on a CUDA device, of any library (CuPy, PyTorch, JAX, Numba)."""
    return hasattr(values, "__cuda_array_interface__")


def to_numpy(values: Any) -> NDArray[Any]:
    """Return an array of any library or device as NumPy array."""
    if not is_gpu_array(values):
        return np.asarray(values)
    if hasattr(values, "get"):  # CuPy's
        found: NDArray[Any] = values.get()
        return found
    from steradian.imaging.engines.cuda.array_backend import device

    backend = device()
    return backend.host(backend.array(values))


def like(values: NDArray[Any], other: Any) -> Any:
    """Convert an array to the library and device of another array."""
    return np.asarray(values, like=other) if is_gpu_array(other) else values


def iter_rows(values: Any) -> Iterable[Any]:
    """Return views for processing in turn: single rows of a NumPy array (cache-sized), a GPU array as a whole."""
    return (values,) if is_gpu_array(values) else (row[None] for row in values)
