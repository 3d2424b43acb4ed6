"""Decoding of binary responses into NumPy arrays, or into memory views if NumPy is not installed."""

from __future__ import annotations

import importlib.util
import math
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeAlias, cast

import httpx

from steradian_client.errors import CorruptTransfer

if TYPE_CHECKING:
    import numpy as np

    Array: TypeAlias = np.ndarray[Any, Any]

RAW: Final = "application/octet-stream"
_CODES: Final = {"f4": "f", "f8": "d", "i1": "b", "i2": "h", "i4": "i", "i8": "q", "u1": "B", "u2": "H", "u4": "I"}
"""Formats of memory views."""


@dataclass(frozen=True)
class Volume:
    """Reconstructed volume, or a slice of a volume, with coordinates along each axis.

    Attributes
    ----------
    values
        float32, indexed [x, y, z], less the axes of which one place was asked for.
    x, y, z
        Places of the values along each axis in metres, z being the depth; ``()`` where there is no such axis.
    """

    values: Array
    x: tuple[float, ...]
    y: tuple[float, ...]
    z: tuple[float, ...]


def parse_array(answer: httpx.Response) -> Array:
    """Decode a binary response into an array with the shape and data type of its headers.

    Raises
    ------
    CorruptTransfer
        When there are more or fewer than the headers say.
    """
    shape = tuple(int(size) for size in answer.headers["X-Shape"].split(",") if size)
    dtype, content = answer.headers["X-Dtype"], answer.content
    if len(content) != math.prod(shape) * int(dtype[2:]):
        raise CorruptTransfer(f"{len(content)} bytes came for an array {shape} of {dtype}")
    if importlib.util.find_spec("numpy") is not None:
        import numpy as np

        return np.frombuffer(content, dtype).reshape(shape)
    if dtype[0] == "|" or (dtype[0] == "<") == (sys.byteorder == "little"):
        seen: Any = memoryview(content)
        return cast("Array", seen.cast(_CODES[dtype[1:]], shape))
    raise CorruptTransfer(f"values of {dtype} need NumPy on this machine")


def slice_axes(report: dict[str, Any], chosen: str | None) -> tuple[tuple[float, ...], ...]:
    """Return the coordinates (m) along x, y and z of a slice in NumPy's syntax, from the report of its volume."""
    shape, origin, spacing = (report.get(name, ()) for name in ("shape", "origin_m", "spacing_m"))
    places: list[tuple[float, ...]] = []
    parts = (chosen or "").split(",") if chosen else []
    for at, (size, first, step) in enumerate(zip(shape, origin, spacing, strict=False)):
        along = tuple(first + step * index for index in range(size))
        part = parts[at].strip() if at < len(parts) else ":"
        if ":" in part:
            along = along[slice(*(int(number) if number.strip() else None for number in part.split(":")))]
        else:
            along = along[int(part) :][:1]
        places.append(along)
    if len(places) == 2:  # an image: lateral place and depth
        places.insert(1, ())
    return tuple(places)
