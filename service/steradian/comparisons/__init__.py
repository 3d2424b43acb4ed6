"""Masks on equal terms: what each promises, and what an object looks like through it."""

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
