"""LRU cache of reconstruction plans, keyed by a hash of geometry and parameters."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray

from steradian.core.validation import content_hash
from steradian.imaging import ReconstructionPlan
from steradian.imaging.parameters import Parameters

MAX_PLANS = 4
MAX_BYTES = 256 * 2**20


class PlanCache:
    """The plans used last, found again by a hash of all that they depend on.

    Parameters
    ----------
    most, most_bytes
        How many are kept, and how much memory they may take together; the one used last is kept in any case.
    """

    def __init__(self, most: int = MAX_PLANS, most_bytes: int = MAX_BYTES) -> None:
        self._most, self._most_bytes = most, most_bytes
        self._plans: OrderedDict[str, tuple[ReconstructionPlan, int]] = OrderedDict()

    def get(self, positions: NDArray[np.float64], samples: int, parameters: Parameters) -> ReconstructionPlan:
        """Return the plan for a geometry, a kept one or a new one.

        Parameters
        ----------
        positions
            (M, 2) sensors in metres, (M, 1) on a line.
        samples
            Samples N_t of an A-line.
        parameters
            All else, without a correction.

        Raises
        ------
        InvalidInput
            When the plan cannot be made.
        """
        arrays = {name: value for name, value in vars(parameters).items() if isinstance(value, np.ndarray)}
        others = {name: value for name, value in vars(parameters).items() if name not in arrays}
        about = {"samples": samples, "arrays": sorted(arrays), **others}
        key = content_hash("k", about, positions, *(arrays[name] for name in sorted(arrays)))
        if key in self._plans and not self._plans[key][0].chosen.notes:  # a GPU that was full may have room by now
            self._plans.move_to_end(key)
            return self._plans[key][0]
        plan = ReconstructionPlan.from_parameters(positions, samples, parameters)
        self._plans[key] = (plan, deep_array_bytes(plan))
        self._plans.move_to_end(key)
        while len(self._plans) > 1 and (len(self._plans) > self._most or self.bytes > self._most_bytes):
            self._plans.popitem(last=False)
        return plan

    @property
    def bytes(self) -> int:
        """Bytes of memory that the kept plans take."""
        return sum(size for _, size in self._plans.values())

    def __len__(self) -> int:
        return len(self._plans)


def deep_array_bytes(thing: object) -> int:
    """Sum the bytes of the arrays within an object."""
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
