"""Query parameters of volume reads: slice, slab, pyramid level, dtype and intensity window."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, TypeAlias

import numpy as np
from fastapi import Query
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from steradian.api.http.array_response import NPY, RAW, ArrayView, ChunkedArray
from steradian.core.exceptions import InvalidInput
from steradian.reconstructions.volumes.grid import VoxelGrid


class AxisView(BaseModel):
    """Coordinates along an axis: value i is at origin + i · spacing."""

    name: Literal["x", "y", "z"]
    origin_m: float = Field(description="Centre of the first voxel (m)")
    spacing_m: float = Field(description="Distance of voxels (m)")
    size: int = Field(description="Number of voxels")


class VoxelsView(ArrayView):
    """Response schema of voxels of a volume or projection, with their axes."""

    axes: list[AxisView] = Field(description="Of those that are left, in the order of the values")
    level: int = Field(description="Each voxel is of 2^level voxels along each axis")
    window: list[float] | None = Field(description="The values that are 0 and 255; null of numbers as they are")


VOXELS: Final[dict[str, Any]] = {
    "model": VoxelsView,
    "content": {kind: {"schema": {"type": "string", "format": "binary"}} for kind in (NPY, RAW)},
}
"""Formats of voxels in the document."""

Part: TypeAlias = Annotated[
    str | None,
    Query(
        max_length=100,
        description="x, y and z, numpy syntax; the axes of the answer. Indices of the full volume at every level",
        examples=["10:20,::2,5"],
    ),
]
Slab: TypeAlias = Annotated[
    str | None,
    Query(max_length=40, description="Voxels along the axis, NumPy syntax; default: all", examples=["100:140"]),
]
Level: TypeAlias = Annotated[
    int | None, Query(ge=0, le=16, description="How many times halved along each axis; 0 is full resolution")
]
Index: TypeAlias = Annotated[
    int | None,
    Query(ge=0, le=2**31, description="Which volume of a series, from 0: its place in the report's frames"),
]
MaxSize: TypeAlias = Annotated[
    int | None,
    Query(
        ge=1,
        le=2**20,
        description="Maximum number of values along each axis; the finest level within it is returned",
        examples=[512],
    ),
]
DataType: TypeAlias = Annotated[
    Literal["float32", "uint8"] | None, Query(description="Type of the values, else as stored; uint8 goes by window")
]
WindowText: TypeAlias = Annotated[
    str | None,
    Query(
        max_length=80,
        description="LEAST,GREATEST value, 0 and 255 of uint8; else from 0 to the volume's maximum (X-Window tells)",
        examples=["0,1.5"],
    ),
]


MAX_WINDOW_END = float(np.finfo(np.float32).max / 2)
"""Largest magnitude of a window's ends, whose differences from values are float32 numbers."""
MIN_WINDOW_WIDTH = float(255 / np.finfo(np.float32).max)
"""Least distance of the ends, with which the scale to 255 steps is a finite float32 number."""


@dataclass(frozen=True)
class Window:
    """Display window: values that map to 0 and 255."""

    least: float
    greatest: float

    @classmethod
    def parse(cls, text: str) -> Window:
        """Parse a window from its text ``LEAST,GREATEST``.

        Raises
        ------
        InvalidInput
            When the text is not two finite numbers, or the second is not the greater.
        """
        try:
            least, greatest = map(float, text.split(","))
        except ValueError:
            least = greatest = math.nan
        if not (math.isfinite(least) and math.isfinite(greatest) and least < greatest):
            raise InvalidInput("window", text, "LEAST,GREATEST: two finite numbers, the second one greater")
        if max(-least, greatest) > MAX_WINDOW_END or greatest - least < MIN_WINDOW_WIDTH:
            ends = f"{-MAX_WINDOW_END:.2g} to {MAX_WINDOW_END:.2g}"
            allowed = f"ends from {ends} and at least {MIN_WINDOW_WIDTH:.2g} apart (float32)"
            raise InvalidInput("window", text, allowed)
        return cls(least, greatest)

    def apply(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """Return values as rounded uint8, clipped to the window; NaN becomes 0."""
        share = (values - values.dtype.type(self.least)) * values.dtype.type(255 / (self.greatest - self.least))
        shown: NDArray[np.uint8] = np.rint(np.clip(np.nan_to_num(share, copy=False), 0, 255)).astype(np.uint8)
        return shown


class ConvertedArray:
    """Chunked array converted to another type: float32, or uint8 by a display window."""

    def __init__(self, source: ChunkedArray, window: Window | None) -> None:
        self._source, self._window, self.shape = source, window, source.shape
        self.dtype: np.dtype[Any] = np.dtype("<f4" if window is None else "u1")

    def iter_chunks(self, index: tuple[slice | int, ...]) -> Iterator[NDArray[Any]]:
        """Yield the selected part in converted chunks."""
        for piece in self._source.iter_chunks(index):
            yield piece.astype(self.dtype, copy=False) if self._window is None else self._window.apply(piece)


def converted(source: ChunkedArray, dtype: str | None, window: Window | None) -> ChunkedArray:
    """Return an array converted to ``dtype``; unchanged if that is ``None``."""
    return source if dtype is None else ConvertedArray(source, window)


def pyramid_level_for(shape: tuple[int, ...], max_size: int | None) -> int:
    """Return the finest pyramid level at which no side is longer than ``max_size``."""
    level = 0
    while max_size is not None and any(-(-side // 2**level) > max_size for side in shape):
        level += 1
    return level


def max_pool(image: NDArray[Any], times: int) -> NDArray[Any]:
    """Downsample a projection by max pooling of ``times`` × ``times`` pixels, without NaN; fewer at the far edges."""
    for axis, side in enumerate(image.shape):
        image = np.fmax.reduceat(image, np.arange(0, side, times), axis=axis)
    return image


def axis_headers(lattice: VoxelGrid, level: int, window: Window | None) -> dict[str, str]:
    """Return the response headers that describe axes (m), pyramid level and display window of voxels."""

    def told(line: tuple[float, ...]) -> str:
        return ",".join(f"{value:.12g}" for value in line)

    about = {
        "X-Axes": ",".join(lattice.names),
        "X-Origin": told(lattice.origin),
        "X-Spacing": told(lattice.spacing),
        "X-Level": str(level),
    }
    return about if window is None else about | {"X-Window": f"{window.least:.9g},{window.greatest:.9g}"}


def axis_json(lattice: VoxelGrid, level: int, window: Window | None) -> dict[str, Any]:
    """Return axes (m), pyramid level and display window of voxels as members of :class:`VoxelsView`."""
    lines = zip(lattice.names, lattice.origin, lattice.spacing, lattice.shape, strict=True)
    axes = [{"name": name, "origin_m": at, "spacing_m": step, "size": size} for name, at, step, size in lines]
    return {"axes": axes, "level": level, "window": window and [window.least, window.greatest]}
