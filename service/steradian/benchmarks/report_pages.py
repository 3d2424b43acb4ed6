"""Shared functions that write benchmark results into documentation pages."""

from __future__ import annotations

import os
import platform
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from steradian._version import __version__


def with_environment(name: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return a JSON document of benchmark rows with machine and version information."""
    machine = {
        "processor": _processor(),
        "cpus": os.cpu_count(),
        "compiled_for": os.environ.get("NUMBA_CPU_NAME", "itself"),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "system": platform.platform(),
        "python": platform.python_version(),
    }
    return {
        "benchmark": name,
        "measured": datetime.now(UTC).isoformat(timespec="seconds"),
        "software": f"steradian {__version__}",
        "machine": machine,
        "rows": rows,
    }


def _processor() -> str:
    """Return the model name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        return platform.processor()
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor())


def replace_between_markers(page: Path, begin: str, end: str, text: str) -> None:
    """Replace the text between the markers ``begin`` and ``end`` of a page by ``text``."""
    said = page.read_text(encoding="utf-8")
    before, after = said.partition(begin)[0], said.partition(end)[2]
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")
