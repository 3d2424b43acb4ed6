"""Unknown parameters of a medium: speeds and thicknesses of layers, and time zero, by name."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LAYER_SPEED, LAYER_THICKNESS, SEARCH_SPAN
from steradian.imaging.medium import Medium

TIME_ZERO_NAME = "time_zero"
_LAYER_NAME = re.compile(r"layer(\d+)\.(sound_speed|thickness)")
_NAMES = "layer1.sound_speed, layer1.thickness, …, or time_zero"

Quantity = Literal["sound_speed", "thickness", "time_zero"]


@dataclass(frozen=True)
class MediumState:
    """Values of all parameters of a search: layers, and the time of the record's first sample after the pulse in s."""

    medium: Medium
    time_zero: float = 0.0

    def value(self, unknown: Unknown) -> float:
        """Return the value of a parameter, in SI units."""
        if unknown.layer is None:
            return self.time_zero
        return float(getattr(self.medium.layers[unknown.layer], unknown.quantity))

    def with_values(self, values: Mapping[Unknown, float]) -> MediumState:
        """Return the state with other values of some parameters."""
        layers, zero = list(self.medium.layers), self.time_zero
        for unknown, value in values.items():
            if unknown.layer is None:
                zero = value
            else:
                change: dict[str, Any] = {unknown.quantity: value}
                layers[unknown.layer] = replace(layers[unknown.layer], **change)
        return MediumState(Medium(layers), zero)


@dataclass(frozen=True)
class Unknown:
    """Parameter of a medium that a search varies.

    Parameters
    ----------
    name
        ``layer1.sound_speed``, ``layer1.thickness`` and so on, numbered from the film downwards; or ``time_zero``.
    low, high
        Range of the search, in m/s, m or s.
    """

    name: str
    low: float
    high: float

    @property
    def quantity(self) -> Quantity:
        """Quantity: sound_speed, thickness or time_zero."""
        quantity: Quantity = self.name.rpartition(".")[2]  # type: ignore[assignment]
        return quantity

    @property
    def layer(self) -> int | None:
        """Index of the layer, from 0 at the film; None for time zero."""
        match = _LAYER_NAME.fullmatch(self.name)
        return int(match[1]) - 1 if match else None

    @property
    def unit(self) -> str:
        """SI unit of the values."""
        return {"sound_speed": "m/s", "thickness": "m", "time_zero": "s"}[self.quantity]

    def clipped(self, value: float) -> float:
        """Return the value, limited to the range."""
        return min(max(value, self.low), self.high)


def resolve_unknowns(
    search: Sequence[str] | None, state: MediumState, *, span: float = 0.1, middle: float = 0.0
) -> tuple[Unknown, ...]:
    """Return the unknowns of a search by name, with the ranges searched.

    Parameters
    ----------
    search
        Names; None: the speeds of all layers.
    state
        Start of the search.
    span
        Half-width of the ranges, relative to the start values; of time zero to ``middle``.
    middle
        Time of flight in s to which the range of time zero is relative.

    Raises
    ------
    InvalidInput
        If a name is unknown or repeated, or ``span`` is out of range.
    """
    span, count = SEARCH_SPAN.check("span", span), len(state.medium.layers)
    check_search(search, count)
    names = [f"layer{i}.sound_speed" for i in range(1, count + 1)] if search is None else search
    found = []
    for name in names:
        unknown = Unknown(name, 0.0, 0.0)
        value, limits = state.value(unknown), LAYER_SPEED if unknown.quantity == "sound_speed" else LAYER_THICKNESS
        if unknown.layer is None:
            found.append(Unknown(name, value - span * middle, value + span * middle))
        else:
            low, high = max(limits.low, value * (1 - span)), min(limits.high, value * (1 + span))
            found.append(Unknown(name, low, high))
    return tuple(found)


def check_search(search: Sequence[str] | None, layers: int) -> None:
    """Raise ``InvalidInput`` for repeated names, and for names that are not parameters of a medium of ``layers``."""
    if search is None:
        return
    if isinstance(search, str) or not search or len(set(search)) < len(search):
        raise InvalidInput("search", search, f"at least one of {_NAMES}, each once")
    for name in search:
        match = _LAYER_NAME.fullmatch(name)
        if match is None and name != TIME_ZERO_NAME:
            raise InvalidInput("search", name, _NAMES)
        if match and not 1 <= int(match[1]) <= layers:
            raise InvalidInput("search", name, f"a layer from 1 to {layers}")
        if match and match[2] == "thickness" and int(match[1]) == layers:
            raise InvalidInput("search", name, "a thickness of a layer above the last, which has none")
