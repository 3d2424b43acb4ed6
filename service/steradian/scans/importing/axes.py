"""Named axes of arrays of A-lines, and their conversion to a table of A-lines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.scans.importing.aline_blocks import BLOCK_BYTES, Block
from steradian.scans.importing.geometry import MOST_POINTS

ORDER = ("frame", "point", "x", "y", "time")
"""Names of axes in the order of a scan file's rows; ``sensor`` is another word for ``point``."""
ALLOWED = 'time and point (or sensor), or time and x, y, once each; frame may be among them: "time, x, y"'


def parse_axes(text: str) -> tuple[str, ...]:
    """Parse a list of axis names, for example "frame, x, y, time".

    Raises
    ------
    InvalidInput
        When a name is unknown or missing, or stands twice.
    """
    names = tuple("point" if name.strip() == "sensor" else name.strip() for name in text.lower().split(","))
    lateral = set(names) - {"frame", "time"}
    if len(set(names)) != len(names) or "time" not in names or lateral not in ({"point"}, {"x"}, {"x", "y"}):
        raise InvalidInput("axes", text, ALLOWED)
    return names


def axes_of(names: tuple[str, ...], count: int, called: str) -> tuple[str, ...]:
    """Return the names of an array's ``count`` axes after validation; ``point`` is replaced by x and y if needed.

    Raises
    ------
    InvalidInput
        When there are more names than axes, or fewer.
    """
    if len(names) == count - 1 and "point" in names:
        place = names.index("point")
        names = (*names[:place], "x", "y", *names[place + 1 :])
    if len(names) != count:
        raise InvalidInput("axes", ", ".join(names), f"{count} names, one for each axis of {called}")
    return names


@dataclass(frozen=True)
class ArrayTable:
    """Table of A-lines over an array in memory or a memory map.

    Parameters
    ----------
    values
        (F, M, N_t) or (F, N_x, N_y, N_t), in whatever order its numbers lie.
    """

    values: NDArray[Any]

    @property
    def frames(self) -> int:
        """Number of frames."""
        return int(self.values.shape[0])

    @property
    def lateral(self) -> tuple[int, ...]:
        """Number of sensors along each lateral axis."""
        return tuple(map(int, self.values.shape[1:-1]))

    @property
    def points(self) -> int:
        """Number of A-lines in a frame."""
        return prod(self.lateral)

    @property
    def samples(self) -> int:
        """Number of samples of an A-line."""
        return int(self.values.shape[-1])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Data type of the samples."""
        return self.values.dtype

    def blocks(self) -> Iterator[Block]:
        """Yield all A-lines in blocks, in order, with the number of each block's first row."""
        row = prod(self.values.shape[2:]) * self.dtype.itemsize
        step, each = max(1, BLOCK_BYTES // max(1, row)), prod(self.lateral[1:])
        for frame, values in enumerate(self.values):
            for start in range(0, len(values), step):
                block = np.ascontiguousarray(values[start : start + step]).reshape(-1, self.samples)
                yield frame * self.points + start * each, block


def table_of(values: NDArray[Any], axes: tuple[str, ...]) -> ArrayTable:
    """Return an array with named axes as a table of A-lines.

    Raises
    ------
    InvalidInput
        When there are too many points.
    """
    wanted = [axes.index(name) for name in ORDER if name in axes]
    turned = values.transpose(wanted)
    table = ArrayTable(turned if "frame" in axes else turned[None])
    if table.points > MOST_POINTS:
        raise InvalidInput("points", table.points, f"at most {MOST_POINTS}; is the order of the axes right?")
    return table
