"""LRU cache of reconstruction plans, keyed by a hash of geometry and parameters."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.validation import content_hash
from steradian.imaging import AcquisitionGeometry, Compute, DirectMethod, ImageGrid, Medium, ReconstructionPlan

MAX_PLANS = 4
MAX_BYTES = 256 * 2**20


class PlanCache:
    """LRU cache of reconstruction plans, keyed by a hash of geometry and parameters.

    Parameters
    ----------
    most, most_bytes
        How many are kept, and how much memory they may take together; the one used last is kept in any case.
    """

    def __init__(self, most: int = MAX_PLANS, most_bytes: int = MAX_BYTES) -> None:
        self._most, self._most_bytes = most, most_bytes
        self._plans: OrderedDict[str, tuple[ReconstructionPlan, int]] = OrderedDict()

    def get(
        self, geometry: AcquisitionGeometry, grid: ImageGrid, method: DirectMethod, compute: Compute
    ) -> ReconstructionPlan:
        """Return the cached plan for these arguments, or create one; plans with a film correction are not cached.

        Raises
        ------
        InvalidInput
            When the plan cannot be made.
        """
        if method.correction is not None:
            return ReconstructionPlan(geometry, grid, method, compute=compute)
        arrays: dict[str, NDArray[Any]] = {}
        others: dict[str, Any] = {"method": method.name}
        for part in (vars(geometry), vars(grid), asdict(method), vars(compute)):
            for name, value in part.items():
                if isinstance(value, np.ndarray):
                    arrays[name] = value
                else:
                    others[name] = asdict(value) if isinstance(value, Medium) else value
        key = content_hash("k", {"arrays": sorted(arrays), **others}, *(arrays[name] for name in sorted(arrays)))
        if key in self._plans and not self._plans[key][0].chosen.notes:  # a GPU that was full may have room by now
            self._plans.move_to_end(key)
            return self._plans[key][0]
        plan = ReconstructionPlan(geometry, grid, method, compute=compute)
        self._plans[key] = (plan, deep_array_bytes(plan))
        self._plans.move_to_end(key)
        while len(self._plans) > 1 and (len(self._plans) > self._most or self.bytes > self._most_bytes):
            self._plans.popitem(last=False)
        return plan

    @property
    def bytes(self) -> int:
        """Memory use of the cached plans in bytes."""
        return sum(size for _, size in self._plans.values())

    def __len__(self) -> int:
        return len(self._plans)


def deep_array_bytes(thing: object) -> int:
    """Return the total bytes of all arrays within an object, nested objects included."""
    seen: set[int] = set()

    def visit(part: object) -> int:
        if id(part) in seen:
            return 0
        if isinstance(part, np.ndarray):
            seen.add(id(part))
            return part.nbytes if part.base is None else visit(part.base)
        if isinstance(part, (list, tuple)):
            return sum(map(visit, part))
        if isinstance(part, dict):
            return sum(map(visit, part.values()))
        if not type(part).__module__.startswith("steradian."):
            return 0
        seen.add(id(part))
        slots = sum(visit(getattr(part, name, None)) for name in getattr(type(part), "__slots__", ()))
        return slots + sum(map(visit, getattr(part, "__dict__", {}).values()))

    return visit(thing)
