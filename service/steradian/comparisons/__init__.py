"""Comparison of masks by figures of merit and by simulation."""

from steradian.comparisons.comparison import Comparison, compare_masks
from steradian.comparisons.design_result import PulseSplit, ScanDesign
from steradian.comparisons.mask_metrics import MaskMetricsRow, evaluate
from steradian.comparisons.phantoms import phantom
from steradian.comparisons.scan_design import design_scan
from steradian.comparisons.simulation import Correlation, Simulation, SimulationResult
from steradian.comparisons.staged_scan import StagedScan

__all__ = [
    "Comparison",
    "Correlation",
    "MaskMetricsRow",
    "PulseSplit",
    "ScanDesign",
    "Simulation",
    "SimulationResult",
    "StagedScan",
    "compare_masks",
    "design_scan",
    "evaluate",
    "phantom",
]
