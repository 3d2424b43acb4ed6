"""Comparison of masks by figures of merit and by simulation."""

from steradian.comparisons.comparison import Comparison, compare_masks
from steradian.comparisons.mask_metrics import MaskMetricsRow, evaluate
from steradian.comparisons.phantoms import phantom
from steradian.comparisons.simulation import Correlation, Simulation, SimulationResult

__all__ = [
    "Comparison",
    "Correlation",
    "MaskMetricsRow",
    "Simulation",
    "SimulationResult",
    "compare_masks",
    "evaluate",
    "phantom",
]
