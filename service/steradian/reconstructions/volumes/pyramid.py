"""Chunk shape and resolution pyramid of volume files."""

from __future__ import annotations

import itertools
import math
from typing import Final

CHUNK_SIDE: Final = 64
"""Voxels along each side of a chunk, about: a slice of any orientation then reads a small part of the volume."""
SMALLEST, LARGEST = CHUNK_SIDE * 2 // 3, CHUNK_SIDE * 3 // 2
MIN_LEVEL_SIDE: Final = 128
"""The last copy has no side longer than this."""

Shape = tuple[int, ...]


def chunk_shape(shape: Shape) -> Shape | None:
    """Return the chunk shape for a volume: sides near :data:`CHUNK_SIDE` with the least padding.

    Returns
    -------
    tuple or None
        None for an image from a line of sensors, which is in one piece.
    """
    return tuple(_side(size) for size in shape) if len(shape) == 3 else None


def _side(size: int) -> int:
    if size <= LARGEST:
        return size
    return min(range(SMALLEST, LARGEST + 1), key=lambda side: (-size % side, abs(math.log(side / CHUNK_SIDE))))


def pyramid_shapes(shape: Shape) -> list[Shape]:
    """Return the shapes of the pyramid levels; each halves the previous one, rounded up."""
    found = [shape]
    while len(shape) == 3 and max(found[-1]) > MIN_LEVEL_SIDE:
        found.append(tuple(-(-size // 2) for size in found[-1]))
    return found[1:]


def file_size(shape: Shape, item: int = 4) -> int:
    """Return the size of a volume file in bytes: values, pyramid levels and projections."""
    total = 0
    for one in (shape, *pyramid_shapes(shape)):
        chunks = chunk_shape(one) or one
        total += item * math.prod(-(-size // side) * side for size, side in zip(one, chunks, strict=True))
    if len(shape) == 3:
        total += item * sum(a * b for a, b in itertools.combinations(shape, 2))
    return total
