"""Units of lengths and times in error messages of imports."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH
from steradian.scans.importing.description import LENGTHS, TIMES, Description


def unit_of_times(said: Description) -> Literal["s", "us", "ns"]:
    """Return the unit in which a file's own times are interpreted."""
    return "s" if said.has_times else said.times


def require_extent(points: NDArray[np.floating[Any]], said: Description) -> None:
    """Raise an error for sensors or an aperture wider than any scanner, with values in the input's unit."""
    if said.aperture is not None and said.aperture * said.length_unit not in LENGTH:
        given = f"{said.aperture:g} {said.lengths}"
        raise InvalidInput("aperture", given, f"{LENGTH}; {unit_hint(True, 'lengths', said.lengths)}")
    spread = float(np.ptp(points, axis=0).max()) if np.isfinite(points).all() else 0.0
    if spread > LENGTH.high:
        field = "positions" if said.grid is None else "grid.interval"
        described = said.grid is not None or isinstance(said.positions, np.ndarray)
        unit = said.lengths if described or not said.has_lengths else "m"
        given = f"sensors over {spread / LENGTHS[unit]:.4g} {unit}"
        raise InvalidInput(field, given, f"over at most {LENGTH.high:g} m; {unit_hint(described, 'lengths', unit)}")


def unit_hint(described: bool, field: Literal["lengths", "times"], unit: str) -> str:
    """Return a hint for error messages: how to state the unit of lengths or times in a description."""
    if not described:
        kind, example = ("length", "mm") if field == "lengths" else ("time", "us")
        return (
            f'numbers of a file count as {unit}; a description with no {kind} of its own, {{"{field}": "{example}"}}, '
            "says their unit"
        )
    others = " or ".join(f'"{name}"' for name in (LENGTHS if field == "lengths" else TIMES) if name != unit)
    return f'the description\'s numbers are in {unit}; it may say "{field}": {others}'
