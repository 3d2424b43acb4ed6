"""A GPU's engine for tests: on a device where CuPy finds one, in Numba's simulator everywhere else."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import pytest


@pytest.fixture
def cuda() -> Callable[..., Any]:
    """Make an engine of tables."""
    from steradian.imaging.engines.cuda import array_backend
    from steradian.imaging.engines.cuda.engine import CudaEngine

    return partial(
        CudaEngine,
        backend=array_backend.SimulatorBackend() if array_backend.unavailable_reason() else array_backend.device(),
    )
