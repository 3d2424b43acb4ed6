"""Compare masks by figures of merit and by simulation."""

from steradian.comparisons.comparison import Comparison, compare_masks
from steradian.comparisons.phantoms import phantom
from steradian.comparisons.promised import Promised, promised
from steradian.comparisons.simulated import Outcome, Simulated, Simulation

__all__ = [
    "Comparison",
    "Outcome",
    "Promised",
    "Simulated",
    "Simulation",
    "compare_masks",
    "phantom",
    "promised",
]
