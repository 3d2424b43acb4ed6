"""Description file of an import: JSON with metadata that an array file lacks.

::

    {
      "sampling_interval": 8, "times": "ns",
      "positions": "positions.csv", "lengths": "mm",
      "aperture": 13.56,
      "sound_speed": 1500
    }

Every number is in metres, seconds and their quotients unless ``lengths`` and ``times`` say otherwise (speeds and rates
always are). Where a description has no length, or no time, of its own, they are the units of the file's. Beside a file
that states something itself, the description has the last word.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound
from steradian.core.quantity_ranges import SOUND_SPEED
from steradian.core.validation import FloatArray, Value, quantity_field
from steradian.scans.importing.axes import parse_axes
from steradian.scans.importing.geometry import MOST_POINTS

LENGTHS = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
TIMES = {"s": 1.0, "us": 1e-6, "ns": 1e-9}
MAX_BYTES = 64 << 20


class GridDescription(Value):
    """Rectangular grid of sensors: pitch and counts, with sensor j of n at (j − n//2)·interval, x slowest."""

    interval: tuple[float, ...] = Field(description="Pitch along x and y, or along a line (lengths)", min_length=1)
    count: tuple[int, ...] | None = Field(default=None, description="Sensors along x and y; none: as the array has")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.interval) > 2 or min(self.interval) <= 0:
            raise InvalidInput("grid.interval", self.interval, "one or two numbers > 0")
        if self.count is not None and (len(self.count) != len(self.interval) or min(self.count) < 1):
            raise InvalidInput("grid.count", self.count, "as many whole numbers as intervals, at least 1")
        return self


class Description(Value):
    """Metadata of a recording to import, from a JSON file; omitted fields come from the recording itself."""

    sampling_interval: float | None = quantity_field("times", "Time between samples", gt=0, default=None)
    time_zero: float | None = quantity_field("times", "From the laser pulse to the first sample", default=None)
    time_zero_samples: float | None = quantity_field(
        "samples",
        "The same in samples, negative where the record begins before the pulse; added to time_zero",
        default=None,
    )
    sound_speed: float | None = quantity_field("m/s", "Speed of sound", default=None, **SOUND_SPEED.limits)
    positions: FloatArray | str | None = Field(
        default=None,
        description="(M, 1 to 3) positions (lengths), or the name of a .csv or .npy file of them or of a k-Wave input "
        "file beside this one",
        union_mode="left_to_right",
    )
    grid: GridDescription | None = Field(default=None, description="Instead of positions")
    weights: FloatArray | None = Field(
        default=None, description="(M,) areas of the sensors, of any scale; scaled to what these sense"
    )
    aperture: float | None = quantity_field(
        "lengths", "Side of the square aperture around the origin", gt=0, default=None
    )
    depth: float | None = quantity_field("lengths", "Distance of the point of interest", gt=0, default=None)
    lengths: Literal["m", "mm", "um"] = "m"
    times: Literal["s", "us", "ns"] = "s"
    axes: str | None = Field(
        default=None,
        description="Names of the array's axes in their order: time; point (or sensor), which may take two axes, or x "
        "and y; frame, where there are several",
        max_length=60,
    )
    mask_order: Literal["matlab", "python"] | None = Field(
        default=None,
        description="Order of the rows of a binary mask: matlab, its first axis fastest; python, its last one "
        "(k-wave-python since 0.6)",
    )
    array: str | None = Field(default=None, description="Name of the A-lines in a file of several arrays")
    scale: float = quantity_field("1", "Pressure per unit of the array", gt=0, default=1.0)
    wavelength: int | None = quantity_field("index", "Which wavelength of an IPASC file; none: all", ge=0, default=None)
    frame: int | None = quantity_field("index", "Which frame of an IPASC file; none: all", ge=0, default=None)
    scanner: str = Field(default="", description="What measured it", max_length=200)
    file_name: str = Field(
        default="", description="Original name of an .sgl file, which holds further values", max_length=300
    )
    simulated: bool | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.positions is not None and self.grid is not None:
            raise InvalidInput("grid", "given", "positions or grid, not both")
        if isinstance(self.positions, str) and Path(self.positions).name != self.positions:
            raise InvalidInput("positions", self.positions, "the bare name of a file beside the description")
        if self.axes is not None:
            parse_axes(self.axes)
        return self

    @property
    def order(self) -> tuple[str, ...] | None:
        """Names of the array's axes; ``None`` if the description states none."""
        return None if self.axes is None else parse_axes(self.axes)

    @property
    def sensors(self) -> int:
        """Number of sensors that positions or the counts of a grid state; 0 if the description states none."""
        if isinstance(self.positions, np.ndarray):
            return len(self.positions)
        counts = None if self.grid is None else self.grid.count
        return 0 if counts is None else int(np.prod(counts, dtype=object))

    @property
    def has_lengths(self) -> bool:
        """Whether the description states a length itself; else ``lengths`` is the unit of the file's lengths."""
        return any(each is not None for each in (self.positions, self.grid, self.aperture, self.depth))

    @property
    def has_times(self) -> bool:
        """Whether the description states a time itself; else ``times`` is the unit of the file's times."""
        return self.sampling_interval is not None or self.time_zero is not None

    @property
    def length_unit(self) -> float:
        """Unit of the description's lengths in metres."""
        return LENGTHS[self.lengths]

    @property
    def time_unit(self) -> float:
        """Unit of the description's times in seconds."""
        return TIMES[self.times]

    def seconds(self, value: float | None) -> float | None:
        """Convert a time of the description to seconds."""
        return None if value is None else value * self.time_unit

    def metres(self, value: float | None) -> float | None:
        """Convert a length of the description to metres."""
        return None if value is None else value * self.length_unit


def read_description(path: Path | None, options: Mapping[str, Any] | None = None) -> Description:
    """Read the description file of an import; ``None`` gives an empty description.

    Parameters
    ----------
    path
        The JSON file.
    options
        Fields that replace those of the file; ``time_zero`` among them is in seconds whatever the unit of times.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is not a JSON object.
    InvalidInput
        When a field is unknown or out of range.
    """
    fields = ({} if path is None else _fields(path)) | dict(options or {})
    if options and "time_zero" in options:
        fields["time_zero"] = options["time_zero"] / TIMES.get(fields.get("times", "s"), 1.0)
    return Description.create(**fields)


def _fields(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise NotFound("file", path.name)
    if path.stat().st_size > MAX_BYTES:
        raise DamagedFile(f"{path.name} has {path.stat().st_size} bytes; allowed: at most {MAX_BYTES}")
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise DamagedFile(f"{path.name} is not JSON: {error}") from error
    if not isinstance(fields, dict):
        raise DamagedFile(f"{path.name} holds no JSON object")
    return fields


def grid_points(counts: tuple[int, ...], interval: tuple[float, ...]) -> NDArray[np.float64]:
    """Return the positions (M, 1) or (M, 2) of a grid of sensors, first axis slowest.

    Raises
    ------
    InvalidInput
        When there are too many.
    """
    if int(np.prod(counts, dtype=object)) > MOST_POINTS:
        raise InvalidInput("grid.count", counts, f"at most {MOST_POINTS} points")
    lines = [(np.arange(n) - n // 2) * step for n, step in zip(counts, interval, strict=True)]
    return np.column_stack([axis.ravel() for axis in np.meshgrid(*lines, indexing="ij")])
