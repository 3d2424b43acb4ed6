"""Sensor masks: arrangements, weights and figures of merit."""

from __future__ import annotations

from typing import Annotated, Final, TypeAlias, get_args

from pydantic import Field

from steradian.core.choices import Weighting
from steradian.masks.by_count import Counted, mask_by_count, nearest_square, with_point_of_interest
from steradian.masks.combined_masks import Combined, PointOfInterest, combined_mask
from steradian.masks.equi_steradian import EquiSteradian, convenient_counts, equi_steradian_mask
from steradian.masks.equiangular import Equiangular, equiangular_mask
from steradian.masks.explicit_points import Points, custom_mask
from steradian.masks.grid import Grid, grid_mask
from steradian.masks.hexagonal import Hexagonal, hexagonal_interval, hexagonal_mask
from steradian.masks.io import read_mask, write_mask
from steradian.masks.mask import Mask
from steradian.masks.multi_beam import multi_beam_mask
from steradian.masks.random_masks import PoissonDisc, Random, poisson_disc_mask, poisson_spacing, random_mask
from steradian.masks.scanner_grid import ScannerGrid
from steradian.masks.subset import Subset, nearest_points, subset_mask
from steradian.masks.weights import voronoi_areas, with_weights

Arrangement: TypeAlias = Annotated[
    EquiSteradian | Equiangular | Grid | Hexagonal | Random | PoissonDisc | Combined | Points | Subset,
    Field(discriminator="arrangement"),
]
"""Parameters of any arrangement, a union with the discriminator ``arrangement``; ``.build()`` returns the mask,
``.expected_count`` estimates its number of points."""
ARRANGEMENTS: Final[tuple[str, ...]] = tuple(
    model.model_fields["arrangement"].default for model in get_args(get_args(Arrangement)[0])
)
"""Names of all arrangements."""

__all__ = [
    "ARRANGEMENTS",
    "Arrangement",
    "Combined",
    "Counted",
    "EquiSteradian",
    "Equiangular",
    "Grid",
    "Hexagonal",
    "Mask",
    "PointOfInterest",
    "Points",
    "PoissonDisc",
    "Random",
    "ScannerGrid",
    "Subset",
    "Weighting",
    "combined_mask",
    "convenient_counts",
    "custom_mask",
    "equi_steradian_mask",
    "equiangular_mask",
    "grid_mask",
    "hexagonal_interval",
    "hexagonal_mask",
    "mask_by_count",
    "multi_beam_mask",
    "nearest_points",
    "nearest_square",
    "poisson_disc_mask",
    "poisson_spacing",
    "random_mask",
    "read_mask",
    "subset_mask",
    "voronoi_areas",
    "with_point_of_interest",
    "with_weights",
    "write_mask",
]
