"""Steradian: sparse photoacoustic tomography with equi-steradian masks and NEDNER-NUFFT reconstruction.

A library first: importing it loads neither the service nor the scanner link nor a compiler; each name below is
loaded when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from steradian import quality
    from steradian.errors import InvalidInput, SteradianError
    from steradian.imaging import ReconstructionPlan, Volume, reconstruct
    from steradian.masks import (
        Mask,
        custom_mask,
        equi_steradian_mask,
        equiangular_mask,
        grid_mask,
        hexagonal_mask,
    )
    from steradian.plans import ScanPlan

__version__ = "0.1.0"

_HOMES = {
    "InvalidInput": "steradian.errors",
    "Mask": "steradian.masks",
    "ReconstructionPlan": "steradian.imaging",
    "ScanPlan": "steradian.plans",
    "SteradianError": "steradian.errors",
    "Volume": "steradian.imaging",
    "custom_mask": "steradian.masks",
    "equi_steradian_mask": "steradian.masks",
    "equiangular_mask": "steradian.masks",
    "grid_mask": "steradian.masks",
    "hexagonal_mask": "steradian.masks",
    "reconstruct": "steradian.imaging",
}

__all__ = [
    "InvalidInput",
    "Mask",
    "ReconstructionPlan",
    "ScanPlan",
    "SteradianError",
    "Volume",
    "custom_mask",
    "equi_steradian_mask",
    "equiangular_mask",
    "grid_mask",
    "hexagonal_mask",
    "quality",
    "reconstruct",
]


def __getattr__(name: str) -> object:
    if name == "quality":
        return importlib.import_module("steradian.quality")
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'steradian' has no attribute {name!r}")
