"""Sensor positions from the sensor mask of k-wave-python as a NumPy array, binary or Cartesian."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.scans.importing import variable_aliases
from steradian.scans.importing.aline_blocks import TraceBlocks
from steradian.scans.importing.axis_inference import longest_delay
from steradian.scans.importing.description import Description
from steradian.scans.importing.geometry import MOST_POINTS
from steradian.scans.importing.mask_order import settle_order
from steradian.scans.importing.source import Metadata


@dataclass(frozen=True)
class MaskSensors:
    """Sensors of a mask: positions (M, A) in metres, and the pitch of a binary mask in metres; 0: Cartesian."""

    positions: NDArray[np.float64]
    pitch: float

    def applied(self, stated: Metadata, table: TraceBlocks, said: Description) -> Metadata:
        """Return metadata with these sensors, those of a binary mask in the order of the A-lines.

        Raises
        ------
        InvalidInput
            When neither the description nor the A-lines show the order.
        """
        points = self.positions
        if self.pitch:
            interval = said.seconds(said.sampling_interval) or stated.sampling_interval or 0.0
            delay = longest_delay(self.pitch, said.sound_speed or stated.sound_speed or 1500.0, interval)
            points = settle_order(table, points, said.mask_order, "python", delay, python=True)
        return replace(stated, points=points)


def read_mask(names: Collection[str], read: Callable[[str], NDArray[Any]], said: Description) -> MaskSensors | None:
    """Return the sensors of an archive's mask; ``None`` without a mask, or where positions are stated.

    Parameters
    ----------
    names
        Names of the arrays.
    read
        Reads one of them.
    said
        The description.

    Raises
    ------
    InvalidInput
        As :func:`mask_positions`.
    """
    name = next((each for each in variable_aliases.MASK if each in names), None)
    stated = any(each in names for each in variable_aliases.POSITIONS)
    if name is None or stated or said.positions is not None or said.grid is not None:
        return None
    numbers = [read(each).reshape(-1) if each in names else np.zeros(0) for each in variable_aliases.STEPS]
    steps = [float(one[0]) if one.size == 1 else None for one in numbers]
    mask = read(name)
    if is_cartesian(mask):
        points = mask.astype(np.float64)
        return MaskSensors(points.T if len(points) <= 3 and len(points) < points.shape[1] else points, 0.0)
    return MaskSensors(mask_positions(mask, steps), min(step for step in steps if step))


def mask_positions(mask: NDArray[Any], steps: Sequence[float | None]) -> NDArray[np.float64]:
    """Return the sensor positions (M, A) of a binary mask in metres, last axis fastest (k-wave-python since 0.6).

    Parameters
    ----------
    mask
        Grid of 1 to 3 axes, nonzero where a sensor is; its voxel n // 2 of each axis is at 0.
    steps
        Pitches along x, y and z in metres; ``None`` where x's applies.

    Raises
    ------
    InvalidInput
        When the mask has more than three axes, no sensor or too many, or there is no pitch.
    """
    if not 1 <= mask.ndim <= 3:
        raise InvalidInput("mask", f"an array of shape {mask.shape}", "a grid of 1 to 3 axes, or (axes, sensors)")
    if not steps[0]:
        raise InvalidInput("dx", "missing", "> 0 (m), the pitch of the mask's grid, as an array beside it")
    count = np.count_nonzero(mask)
    if not 1 <= count <= MOST_POINTS:
        raise InvalidInput("mask", f"{count} sensors", f"1 to {MOST_POINTS}")
    places = np.argwhere(mask)
    pitches = np.array([step or steps[0] for step in steps[: mask.ndim]])
    points: NDArray[np.float64] = (places - np.array(mask.shape) // 2) * pitches
    return points


def is_cartesian(mask: NDArray[Any]) -> bool:
    """Return whether a mask has coordinates of sensors: numbers other than 0 and 1 along two or three axes."""
    return mask.ndim == 2 and mask.dtype.kind == "f" and min(mask.shape) <= 3 and not bool(np.isin(mask, (0, 1)).all())
