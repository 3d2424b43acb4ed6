"""Argument validation shared by plans, operators and fits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import prod
from typing import Any, Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH, THREADS, as_finite_float
from steradian.imaging.compute import thread_pool as workers

Floats: TypeAlias = NDArray[np.float64]

MIN_FLOAT32_TOLERANCE = 5e-6
"""Tolerance below which float32 does not suffice."""
ROUNDING = 2.0**-23
"""Relative rounding of positions that once were float32; sensors that far beyond the aperture are on its edge."""
MAX_EXPONENT = {"float32": 80, "float64": 960}
"""Exponent of two from which sums of so large samples may overflow."""
MIN_APERTURE = 1e-6
"""Metres: far below the wavelength of any sound that a film hears."""
MIN_AREA_RATIO, MAX_AREA_RATIO = 1e-7, 4.0
"""What weights may sum to, in areas of the aperture. Sensors may cover a small part of it, and the cells of a coarse
grid reach beyond an aperture that ends at the outermost sensors; millimetres for metres are a factor of 1000 at
least."""


@runtime_checkable
class Sensors(Protocol):
    """Protocol of a mask: positions, weights and aperture of sensors."""

    @property
    def positions(self) -> Any:
        """Sensor positions, (M, 2) or (M, 1) in metres."""

    @property
    def weights(self) -> Any:
        """Weights of the sensors: (M,) areas in m², or lengths in m."""

    @property
    def aperture(self) -> Any:
        """Side length in metres."""


def resolve_sensors(
    positions: ArrayLike | Sensors, weights: Any, aperture: float | Sequence[float] | None
) -> tuple[ArrayLike, Any, Any]:
    """Return positions, weights and aperture; missing arguments are taken from a mask."""
    if isinstance(positions, Sensors):
        own = positions
        return (
            own.positions,
            own.weights if weights is None else weights,
            own.aperture if aperture is None else aperture,
        )
    return positions, weights, aperture


def check_integer(field: str, value: object, low: int, high: int | None = None) -> int:
    """Return a whole number from ``low`` (to ``high``), given as integer or float."""
    allowed = f"a whole number from {low}" + ("" if high is None else f" to {high:,}")
    number = as_finite_float(field, value, allowed)
    if number != int(number) or number < low or (high is not None and number > high):
        raise InvalidInput(field, value, allowed)
    return int(number)


def check_choice(field: str, value: object, allowed: Iterable[str], more: str = "") -> None:
    """Raise ``InvalidInput`` unless the value is one of the names."""
    names = tuple(allowed)
    if not (isinstance(value, str) and value in names):
        raise InvalidInput(field, value, ", ".join(names) + more)


def per_axis(field: str, value: Any, count: int) -> tuple[object, ...]:
    """Return one value for each lateral axis; a single value applies to both."""
    if isinstance(value, str | bytes) or np.ndim(value) == 0:
        return (value,) * count
    values = tuple(value)
    if len(values) != count:
        raise InvalidInput(field, value, f"one number, or {count} (one a lateral axis)")
    return values


def depth_pair(depth: Any, allowed: str = "two depths in metres, rising, from 0") -> tuple[float, float]:
    """Return first and last depth in metres, validated as two rising numbers."""
    if np.shape(depth) != (2,):
        raise InvalidInput("depth", depth, allowed)
    low, high = (as_finite_float("depth", each, allowed) for each in depth)
    if low > high:
        raise InvalidInput("depth", depth, allowed)
    return low, high


def depths(depth: tuple[float, float], end: float) -> tuple[float, float]:
    """Return first and last depth in metres, validated as two rising numbers from 0 to ``end``."""
    allowed = f"two depths in metres, rising, within 0 … {end:.6g}"
    low, high = depth_pair(depth, allowed)
    if not -1e-9 * end <= low <= high <= end * (1 + 1e-9):
        raise InvalidInput("depth", depth, allowed)
    return low, high


def apertures(value: object, axes: int) -> tuple[float, ...]:
    """Return the aperture's side lengths in metres, one for each lateral axis."""
    sides = tuple(LENGTH.check("aperture", side) for side in per_axis("aperture", value, axes))
    if min(sides) < MIN_APERTURE:
        raise InvalidInput("aperture", min(sides), f"{MIN_APERTURE:g} to {LENGTH.high:g} m")
    return sides


def precision_name(dtype: DTypeLike) -> Literal["float32", "float64"]:
    """Return the name of a working precision."""
    try:
        name = np.dtype(dtype).name
    except TypeError:
        name = ""
    if name == "float64":
        return "float64"
    if name != "float32":
        raise InvalidInput("dtype", dtype, "float32, float64 or None")
    return "float32"


def working_precision(dtype: DTypeLike | None, tolerance: float) -> Literal["float32", "float64"]:
    """Return the working precision: the requested one, or the one that the tolerance requires."""
    if dtype is None:
        return "float32" if tolerance >= MIN_FLOAT32_TOLERANCE else "float64"
    name = precision_name(dtype)
    if name == "float32" and tolerance < MIN_FLOAT32_TOLERANCE:
        raise InvalidInput("dtype", name, f"float64 or None for a tolerance below {MIN_FLOAT32_TOLERANCE:g}")
    return name


def thread_count(threads: object) -> int:
    """Return the maximum number of threads."""
    return workers.available_threads() if threads is None else THREADS.check_integer("threads", threads)


def check_positions(positions: ArrayLike) -> Floats:
    """Return positions (M, d−1) in metres, validated as finite and near the aperture."""
    x = as_float64("sensors", positions, "shape (M, 2), or (M,) in 2-D, in metres; M ≥ 1")
    shape = x.shape
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2 or x.shape[1] not in (1, 2) or len(x) == 0:
        raise InvalidInput("sensors", f"an array of shape {shape}", "shape (M, 2), or (M,) in 2-D; M ≥ 1")
    bad = np.flatnonzero(~np.isfinite(x).all(axis=1))
    if bad.size:
        raise InvalidInput("sensors", f"not finite at sensor {bad[0]}", "finite numbers in metres")
    worst = int(np.abs(x).max(axis=1).argmax())
    if np.abs(x[worst]).max() > LENGTH.high / 2:
        point = ", ".join(f"{value:g}" for value in x[worst])
        raise InvalidInput(f"sensors[{worst}]", f"({point})", f"±{LENGTH.high / 2:g} m about the middle, in metres")
    return x


def check_weights(h: Floats, x: Floats, aperture: tuple[float, ...]) -> Floats:
    """Check weights (M,) of sensors (M, d−1): areas in m² (lengths in m), none negative, with a plausible sum."""
    count = len(x)
    unit = "m²" if len(aperture) == 2 else "m"
    if h.shape != (count,):
        raise InvalidInput("weights", f"an array of shape {h.shape}", f"one weight a sensor, shape ({count},)")
    bad = np.flatnonzero(~np.isfinite(h))
    if bad.size:
        raise InvalidInput(f"weights[{bad[0]}]", h[bad[0]], f"a finite area, at least 0 ({unit})")
    if (h < 0).any():
        raise InvalidInput(f"weights[{int(h.argmin())}]", f"{h.min():.6g}", f"an area, at least 0 ({unit})")
    area, total = prod(aperture), float(h.sum())
    reached = prod(np.maximum(aperture, 2 * np.abs(x).max(axis=0)).tolist())  # more only where sensors wrap around
    if not MIN_AREA_RATIO * area <= total <= MAX_AREA_RATIO * reached:
        ratios = f"{MIN_AREA_RATIO:g} to {MAX_AREA_RATIO:g}"
        allowed = f"areas in {unit} that sum to {ratios} times the aperture's {area:.6g} {unit}"
        raise InvalidInput("weights", f"a sum of {total:.6g}", allowed)
    return h


def as_float64(field: str, values: ArrayLike, allowed: str) -> Floats:
    """Return a new float64 copy of an array."""
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "iuf":
            raise TypeError
        return np.array(array, np.float64)
    except (TypeError, ValueError):
        raise InvalidInput(field, _kind(values), allowed) from None


def describe_non_finite(traces: NDArray[Any]) -> str:
    """Return the reason why A-lines (M, N_t) cannot be reconstructed."""
    for m, row in enumerate(traces):
        bad = np.flatnonzero(~np.isfinite(row))
        if bad.size:
            return f"{row[bad[0]]} at row {m}, column {bad[0]}"
    return "beyond the range of the working precision"


def _kind(values: object) -> str:
    return f"an array of {values.dtype}" if isinstance(values, np.ndarray) else f"a {type(values).__name__}"
