"""Conformance tests of PROTOCOL.md, runnable against any port."""

from fabry_perot.conformance import data, emission, wire  # noqa: F401  # they fill the list
from fabry_perot.conformance.peer import Peer
from fabry_perot.conformance.report import Outcome, as_junit, as_table, run
from fabry_perot.conformance.scenarios import SCENARIOS

__all__ = ["SCENARIOS", "Outcome", "Peer", "as_junit", "as_table", "run"]
