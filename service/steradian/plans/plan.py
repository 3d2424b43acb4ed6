"""A plan: a mask with the order and pace of its interrogation."""

from __future__ import annotations

from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from steradian.errors import InvalidInput
from steradian.masks import Mask
from steradian.plans.order import VisitOrder, visit_order
from steradian.validation import Value, content_hash, quantity


class ScanPlan(Value):
    """What a scanner needs to know to measure a mask; immutable and identified by its content."""

    mask: Mask
    pulse_rate: float = quantity("Hz", "Laser pulses per second", ge=0.1, le=10_000, default=50.0)
    averages: int = quantity("pulses", "Pulses averaged into one A-line", ge=1, le=65_535, default=1)
    samples: int = quantity("samples", "Samples of an A-line, N_t", ge=16, le=65_536, default=1024)
    sampling_interval: float = quantity("s", "Time between samples, dt", ge=1e-10, le=1e-5, default=8e-9)
    sound_speed: float = quantity("m/s", "Assumed speed of sound", ge=300, le=6000, default=1500.0)
    order: VisitOrder = VisitOrder.SNAKE

    @model_validator(mode="after")
    def _check(self) -> Self:
        record = self.samples * self.sampling_interval
        if record * self.pulse_rate >= 1:
            raise InvalidInput(
                "pulse_rate", f"{self.pulse_rate:g}", f"less than one pulse per record, {1 / record:g} Hz"
            )
        return self

    @cached_property
    def id(self) -> str:
        """Identifier of the content, ``p`` and 24 hexadecimal digits."""
        return content_hash("p", self.model_dump(mode="json", exclude={"mask"}) | {"mask": self.mask.id})

    @cached_property
    def visit(self) -> NDArray[np.int64]:
        """(M,) indices into the mask's positions, in the order of interrogation."""
        return visit_order(self.mask.positions, self.order)

    @property
    def recording_depth(self) -> float:
        """Farthest distance from a sensor that its A-line covers, in metres."""
        return (self.samples - 1) * self.sampling_interval * self.sound_speed
