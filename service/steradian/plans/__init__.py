"""Plans: in what order and at what pace a mask is measured."""

from steradian.plans.order import VisitOrder, travel, visit_order
from steradian.plans.plan import ScanPlan
from steradian.plans.preview import Finding, Preview, preview

__all__ = ["Finding", "Preview", "ScanPlan", "VisitOrder", "preview", "travel", "visit_order"]
