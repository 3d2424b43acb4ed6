"""Conformance tests of PROTOCOL.md, runnable against any port."""

from fabry_perot.conformance import emission, plan_and_data, wire  # noqa: F401  # they fill the list
from fabry_perot.conformance.peer import ConformanceHost
from fabry_perot.conformance.registry import SCENARIOS
from fabry_perot.conformance.report import ConformanceResult, as_junit, as_table, run

__all__ = ["SCENARIOS", "ConformanceHost", "ConformanceResult", "as_junit", "as_table", "run"]
