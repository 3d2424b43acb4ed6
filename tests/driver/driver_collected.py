"""All A-lines of a plan."""

from __future__ import annotations

import fabry_perot


def collect(scanner) -> list:
    """Take all A-lines to the end of the plan, as an application on a busy machine does."""
    lines = []
    while True:
        try:
            for batch in scanner.alines():
                lines += batch
                scanner.acknowledge(batch[-1])
            return lines
        except fabry_perot.LeaseExpired:  # this machine was busy with something else for half a second
            scanner.resume()
