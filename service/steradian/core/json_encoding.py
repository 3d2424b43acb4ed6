"""Conversion of dataclasses and arrays to JSON-compatible values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from typing import Any

import numpy as np


def to_jsonable(figures: Any) -> Any:
    """Convert values to JSON types: dataclasses to objects, arrays to lists, non-finite numbers to null.

    Examples
    --------
    >>> to_jsonable({"best": np.float32(1.5), "curve": np.array([1.0, np.nan])})
    {'best': 1.5, 'curve': [1.0, None]}
    """
    if is_dataclass(figures) and not isinstance(figures, type):
        return to_jsonable(asdict(figures))
    if isinstance(figures, Mapping):
        return {str(name): to_jsonable(value) for name, value in figures.items()}
    if isinstance(figures, np.ndarray | np.generic):
        return nan_to_none(figures)
    if isinstance(figures, list | tuple | set | frozenset):
        return [to_jsonable(value) for value in figures]
    if isinstance(figures, float):
        return figures if math.isfinite(figures) else None
    return figures if isinstance(figures, str | int | None) else str(figures)


def nan_to_none(values: Any) -> Any:
    """Return an array as nested lists, with None for non-finite numbers."""
    array = np.asarray(values)
    if array.dtype.kind != "f" or np.isfinite(array).all():
        return array.tolist()
    found = array.astype(object)
    found[~np.isfinite(array)] = None
    return found.tolist()
