"""Sensor arrangements: where on the plane to sense."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from pydantic import Field

from steradian.masks.equi_steradian import EquiSteradian, convenient_counts, equi_steradian_mask
from steradian.masks.grid import Grid, grid_mask
from steradian.masks.mask import Mask
from steradian.masks.points import Points, custom_mask

Arrangement: TypeAlias = Annotated[EquiSteradian | Grid | Points, Field(discriminator="arrangement")]
"""Parameters of any arrangement, told apart by ``arrangement``; ``.build()`` makes the mask."""

__all__ = [
    "Arrangement",
    "EquiSteradian",
    "Grid",
    "Mask",
    "Points",
    "convenient_counts",
    "custom_mask",
    "equi_steradian_mask",
    "grid_mask",
]
