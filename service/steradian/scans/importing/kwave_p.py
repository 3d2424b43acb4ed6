"""Axis order of k-Wave's array ``p`` without sensor positions, and check that its sensors form a line."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.scans.importing.aline_blocks import RawTraceBlocks, TraceBlocks, mapped
from steradian.scans.importing.axis_inference import first_break, longest_delay, time_axis
from steradian.scans.importing.description import Description
from steradian.scans.importing.import_remarks import remark
from steradian.scans.importing.source import Metadata

MASK_OR_POSITIONS = "{} k-Wave's sensor mask as mask, with its pitch dx, or positions"
PITCH_ALONE = "dx alone of a line or a full grid (time, y, z)"


def placing_arrays(name: str) -> str:
    """Return the arrays that place the sensors of the A-lines ``name`` in a file, for messages that ask for them."""
    needed = MASK_OR_POSITIONS.format(f"beside {name}")
    return f"{needed}, or {PITCH_ALONE}" if name == "p" else needed


def order_of_p(values: NDArray[Any]) -> tuple[str, ...]:
    """Return the axis names of k-Wave's ``p``, with time as first or last axis according to the samples.

    Of three axes time is the first, as k-Wave has it, unless the samples say otherwise; two must say.
    """
    time = time_axis(values, (0, values.ndim - 1))
    if values.ndim == 3:
        if time == 2:
            remark(f"p of the shape {values.shape} was taken as (x, y, time): along time its beginning is quiet")
        return ("x", "y", "time") if time == 2 else ("time", "x", "y")
    if time is None:
        raise InvalidInput(
            "axes",
            f"p of the shape {values.shape}, by its samples either (time, sensor) or (sensor, time)",
            'the order in a description, "axes": "time, sensor" or "sensor, time"',
        )
    order = ("time", "point") if time == 0 else ("point", "time")
    words = "(time, sensor)" if time == 0 else "(sensor, time)"
    remark(f"p of the shape {values.shape} was taken as {words}: along that time axis its beginning is quiet")
    return order


def order_of_square(values: NDArray[Any], usual: tuple[str, ...]) -> tuple[str, ...]:
    """Return the axis names of a square array: the usual order, unless the samples show the opposite."""
    time = time_axis(values, (0, 1))
    if time is None or usual[time] == "time":
        return usual
    words = "(time, sensor)" if time == 0 else "(sensor, time)"
    remark(f"the A-lines were taken as {words}: along that time axis their beginning is quiet")
    return usual[::-1]


def require_line(table: TraceBlocks, stated: Metadata, said: Description, pitch: float) -> None:
    """Raise InvalidInput if A-lines without positions do not look like neighbours on a line."""
    if not isinstance(table, RawTraceBlocks) or table.points < 3:
        return
    shape = (table.samples, table.points) if table.time_first else (table.points, table.samples)
    values = mapped(table.file, table.offset, table.dtype, shape)
    interval = said.seconds(said.sampling_interval) or stated.sampling_interval or 0.0
    speed = said.sound_speed or stated.sound_speed or 1500.0
    row = first_break(values.T if table.time_first else values, longest_delay(pitch, speed, interval))
    if row is not None:
        raise InvalidInput(
            "positions",
            f"missing: the A-lines {row} and {row + 1} of p are too unlike to be neighbours on a line",
            MASK_OR_POSITIONS.format("beside p")
            + "; or in a description (JSON) positions, or a grid if it is one or a line",
        )
    remark(f"the {table.points} sensors of p were taken as a line with a pitch of {1e6 * pitch:g} µm")
