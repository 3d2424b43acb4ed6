"""Steradian: sparse photoacoustic tomography with equi-steradian masks and NEDNER-NUFFT reconstruction.

A library first: importing it loads neither the service nor the scanner link nor a compiler; each name below is
loaded when it is first used.
"""

from __future__ import annotations

from steradian._display_loaders import display_loaders as _display_loaders
from steradian._version import __version__ as __version__

TYPE_CHECKING = False  # not typing's: whoever starts the command line waits for what is read here
if TYPE_CHECKING:
    from steradian import quality
    from steradian.comparisons import compare_masks, design_scan
    from steradian.core.exceptions import InvalidInput, SteradianError
    from steradian.imaging import (
        Acquisition,
        AcquisitionGeometry,
        Attenuation,
        Compute,
        Gridded,
        ImageGrid,
        Iterative,
        Layer,
        LinearKappa,
        Medium,
        NearestKappa,
        Ner,
        Nufft,
        ReconstructionPlan,
        Volume,
        reconstruct,
        uncertainty,
    )
    from steradian.imaging.artefact_suppression import suppress_artefacts
    from steradian.imaging.operators import ForwardOperator
    from steradian.io import open as open
    from steradian.masks import (
        Mask,
        custom_mask,
        equi_steradian_mask,
        equiangular_mask,
        grid_mask,
        hexagonal_mask,
    )
    from steradian.plans import ScanPlan
    from steradian.reconstructions.scan import Scan
    from steradian.reconstructions.stages.library import focus, survey
    from steradian.reconstructions.studies.medium_search import find_medium
    from steradian.reconstructions.studies.width import measure_width
    from steradian.scans.frames import FrameChoice

_HOMES = {
    "Acquisition": "steradian.imaging",
    "AcquisitionGeometry": "steradian.imaging",
    "Attenuation": "steradian.imaging",
    "Compute": "steradian.imaging",
    "ForwardOperator": "steradian.imaging.operators",
    "FrameChoice": "steradian.scans.frames",
    "Gridded": "steradian.imaging",
    "ImageGrid": "steradian.imaging",
    "InvalidInput": "steradian.core.exceptions",
    "Iterative": "steradian.imaging",
    "Layer": "steradian.imaging",
    "Medium": "steradian.imaging",
    "LinearKappa": "steradian.imaging",
    "Mask": "steradian.masks",
    "NearestKappa": "steradian.imaging",
    "Ner": "steradian.imaging",
    "Nufft": "steradian.imaging",
    "ReconstructionPlan": "steradian.imaging",
    "Scan": "steradian.reconstructions.scan",
    "ScanPlan": "steradian.plans",
    "SteradianError": "steradian.core.exceptions",
    "Volume": "steradian.imaging",
    "compare_masks": "steradian.comparisons",
    "custom_mask": "steradian.masks",
    "design_scan": "steradian.comparisons",
    "equi_steradian_mask": "steradian.masks",
    "equiangular_mask": "steradian.masks",
    "find_medium": "steradian.reconstructions.studies.medium_search",
    "focus": "steradian.reconstructions.stages.library",
    "grid_mask": "steradian.masks",
    "hexagonal_mask": "steradian.masks",
    "measure_width": "steradian.reconstructions.studies.width",
    "open": "steradian.io",
    "reconstruct": "steradian.imaging",
    "suppress_artefacts": "steradian.imaging.artefact_suppression",
    "survey": "steradian.reconstructions.stages.library",
    "uncertainty": "steradian.imaging",
}

__all__ = [
    "Acquisition",
    "AcquisitionGeometry",
    "Attenuation",
    "Compute",
    "ForwardOperator",
    "FrameChoice",
    "Gridded",
    "ImageGrid",
    "InvalidInput",
    "Iterative",
    "Layer",
    "LinearKappa",
    "Mask",
    "Medium",
    "NearestKappa",
    "Ner",
    "Nufft",
    "ReconstructionPlan",
    "Scan",
    "ScanPlan",
    "SteradianError",
    "Volume",
    "compare_masks",
    "custom_mask",
    "design_scan",
    "equi_steradian_mask",
    "equiangular_mask",
    "find_medium",
    "focus",
    "grid_mask",
    "hexagonal_mask",
    "measure_width",
    "quality",
    "reconstruct",
    "suppress_artefacts",
    "survey",
    "uncertainty",
]  # and open, which would take the place of Python's own in "from steradian import *"


def __getattr__(name: str) -> object:
    import importlib

    if name == "quality":
        return importlib.import_module("steradian.quality")
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'steradian' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "open"])


def _load_displays() -> None:
    """Import the modules that register implementations with :mod:`steradian.drawing.display_dispatch`."""
    import steradian.comparisons.design_plots
    import steradian.masks.plots
    import steradian.plans.plots
    import steradian.reconstructions.display  # noqa: F401


_display_loaders.append(_load_displays)
