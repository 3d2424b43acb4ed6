"""Scan plans: visit order, timing and cost preview."""

from steradian.plans.fringe import Fringe
from steradian.plans.order import VisitOrder, travel, visit_order
from steradian.plans.plan import ScanPlan
from steradian.plans.preview import Finding, Preview, preview
from steradian.plans.progressive import Progressive, progressive
from steradian.plans.scanner import Link, Motion, ScannerLimits, Tuning
from steradian.plans.tuning_map import TuningMap

__all__ = [
    "Finding",
    "Fringe",
    "Link",
    "Motion",
    "Preview",
    "Progressive",
    "ScanPlan",
    "ScannerLimits",
    "Tuning",
    "TuningMap",
    "VisitOrder",
    "preview",
    "progressive",
    "travel",
    "visit_order",
]
