"""Chunk shape and resolution pyramid of volume files."""

from __future__ import annotations

import itertools
import math
from typing import Final

SIDE: Final = 64
"""Voxels along each side of a chunk, about: a slice of any orientation then reads a small part of the volume."""
SMALLEST, LARGEST = SIDE * 2 // 3, SIDE * 3 // 2
COARSEST: Final = 128
"""The last copy has no side longer than this."""

Shape = tuple[int, ...]


def chunks_of(shape: Shape) -> Shape | None:
    """Return the shape of chunks: that of least padding in all, of those as near to :data:`SIDE` as any.

    Returns
    -------
    tuple or None
        None for an image from a line of sensors, which is in one piece.
    """
    return tuple(_side(size) for size in shape) if len(shape) == 3 else None


def _side(size: int) -> int:
    if size <= LARGEST:
        return size
    return min(range(SMALLEST, LARGEST + 1), key=lambda side: (-size % side, abs(math.log(side / SIDE))))


def coarser_shapes(shape: Shape) -> list[Shape]:
    """Return the shapes of the coarser copies, each half of the one before, rounded up."""
    found = [shape]
    while len(shape) == 3 and max(found[-1]) > COARSEST:
        found.append(tuple(-(-size // 2) for size in found[-1]))
    return found[1:]


def stored_bytes(shape: Shape, item: int = 4) -> int:
    """Return how many bytes values, their coarser copies and projections take in a volume file."""
    total = 0
    for one in (shape, *coarser_shapes(shape)):
        chunks = chunks_of(one) or one
        total += item * math.prod(-(-size // side) * side for size, side in zip(one, chunks, strict=True))
    if len(shape) == 3:
        total += item * sum(a * b for a, b in itertools.combinations(shape, 2))
    return total
