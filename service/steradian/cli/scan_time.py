"""Parser of the duration of a scan, in hours, minutes or seconds."""

from __future__ import annotations

import re

import typer

UNITS = {"h": 3600.0, "min": 60.0, "s": 1.0, "": 1.0}


def scan_time(value: str | float) -> float:
    """Return a duration such as ``15min``, ``1.5h`` or ``90s`` in seconds; a bare number is in seconds."""
    match = re.fullmatch(r"\s*([-+0-9.eE]+?)\s*(h|min|s|)\s*", str(value))
    try:
        if match:
            return float(match[1]) * UNITS[match[2]]
    except ValueError:
        pass
    raise typer.BadParameter(f"{value!r} is not a duration, for example 15min or 90s")


scan_time.__name__ = "time"
