"""Scan plans: visit order, timing and cost preview."""

from steradian.core.choices import VisitOrder
from steradian.plans.excitation import ExcitationPreview, preview_excitation
from steradian.plans.fringe import Fringe
from steradian.plans.plan import ScanPlan
from steradian.plans.preview import PlanCost, PlanIssue, preview
from steradian.plans.progressive_order import Progressive, progressive
from steradian.plans.scanner_model import Link, Motion, ScannerLimits, Tuning
from steradian.plans.tuning_map import TuningMap
from steradian.plans.visit_order import path_length, visit_order

__all__ = [
    "ExcitationPreview",
    "Fringe",
    "Link",
    "Motion",
    "PlanCost",
    "PlanIssue",
    "Progressive",
    "ScanPlan",
    "ScannerLimits",
    "Tuning",
    "TuningMap",
    "VisitOrder",
    "path_length",
    "preview",
    "preview_excitation",
    "progressive",
    "visit_order",
]
