"""Validated parameters of a reconstruction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

from numpy.typing import ArrayLike, DTypeLike

from steradian.core.exceptions import InvalidInput
from steradian.core.units import SAMPLING_INTERVAL, SOUND_SPEED, TIME_ZERO, as_finite_float
from steradian.imaging import validation as checks
from steradian.imaging.film_response import MAX_GAIN, InverseFilter
from steradian.imaging.iterative_options import Iterative
from steradian.imaging.transforms.windows import Shape, Window

DirectMethod: TypeAlias = Literal["nedner", "ner", "linear", "nearest", "interpolated"]
Method: TypeAlias = DirectMethod | Literal["iterative"]
Precision: TypeAlias = Literal["float32", "float64"]
Device: TypeAlias = Literal["auto", "cpu", "gpu"]
METHODS: tuple[str, ...] = (*get_args(DirectMethod), "iterative")


@dataclass(frozen=True, kw_only=True, eq=False)
class Parameters:
    """All that is chosen, but sensors and A-lines; fields as the parameters of :func:`steradian.imaging._reconstruct`.

    What needs no more than the fields themselves is checked here, whoever makes the value; what has to do with the
    sensors in :func:`steradian.imaging.geometry.reconstruction.geometry`. What the method has no use for is refused,
    but weights.

    Raises
    ------
    InvalidInput
        Naming the parameter and what is allowed.
    """

    sampling_interval: float
    sound_speed: float
    aperture: float | Sequence[float] | None = None
    modes: int | Sequence[int]
    weights: ArrayLike | Literal["voronoi"] | None = None
    upsampling: int = 1
    depth_range: tuple[float, float] | None = None
    method: Method = "nedner"
    tolerance: float = 1e-4
    window: Shape | Window = "kaiser-bessel"
    time_zero: float = 0.0
    time_padding: float = 1.0
    lateral_padding: float | None = None
    wrap: bool = False
    highest_frequency: float | Literal["signal"] | None = None
    depth_step: float | None = None
    correction: InverseFilter | None = None
    iterative: Iterative | None = None
    dtype: DTypeLike | None = None
    memory_limit: int | None = None
    threads: int | None = None
    device: Device = "cpu"
    device_memory: int | None = None

    def __post_init__(self) -> None:
        for name, check in FIELD_VALIDATORS.items():
            object.__setattr__(self, name, check(name, getattr(self, name)))
        checks.working_precision(self.dtype, self.tolerance)
        if self.method != "iterative":
            self._unused("iterative", self.iterative, None, "; these options are of 'iterative' alone")
            return
        for name in ("window", "time_padding", "highest_frequency", "depth_step"):
            self._unused(name, getattr(self, name), getattr(type(self), name), ", which uses no other")
        if self.correction is not None:
            self._unused("correction.max_gain", self.correction.max_gain, MAX_GAIN, ", which uses no other")

    def _unused(self, name: str, value: object, usual: object, why: str) -> None:
        if value != usual:
            shown = f"{usual:g}" if isinstance(usual, float) else usual
            raise InvalidInput(name, value, f"{shown} with the method {self.method}{why}")

    @property
    def precision(self) -> Precision:
        """Working precision."""
        return checks.working_precision(self.dtype, self.tolerance)

    @property
    def max_threads(self) -> int:
        """Threads to use at most."""
        return checks.thread_count(self.threads)


def _one_of(names: tuple[str, ...], more: str = "") -> Callable[[str, Any], Any]:
    def check(field: str, value: Any) -> Any:
        checks.check_choice(field, value, names, more)
        return value

    return check


def _instance(kind: type, what: str) -> Callable[[str, Any], Any]:
    def check(field: str, value: Any) -> Any:
        if not isinstance(value, kind | None):
            raise InvalidInput(field, type(value).__name__, f"{what}, or None")
        return value

    return check


def _window(field: str, value: Any) -> Any:
    return value if isinstance(value, Window) else _one_of(get_args(Shape), ", or a Window")(field, value)


def _padding(field: str, value: Any) -> float:
    return checks.check_range(field, value, 1, 16, "a factor")


def _highest(field: str, value: Any) -> Any:
    allowed = 'a frequency above 0 Hz, "signal" or None'
    if isinstance(value, str | None):
        if value not in ("signal", None):
            raise InvalidInput(field, value, allowed)
        return value
    number = as_finite_float(field, value, allowed)
    if number <= 0:
        raise InvalidInput(field, value, allowed)
    return number


def _limit(field: str, value: Any) -> Any:
    if value is not None:
        as_finite_float(field, value, "bytes, or None")
    return value


FIELD_VALIDATORS: dict[str, Callable[[str, Any], Any]] = {
    "method": _one_of(METHODS),
    "window": _window,
    "correction": _instance(InverseFilter, "a Correction"),
    "iterative": _instance(Iterative, "steradian.imaging.Iterative(…)"),
    "tolerance": lambda field, value: checks.check_range(field, value, 1e-12, 0.1, "a relative error"),
    "threads": lambda field, value: value if value is None else checks.thread_count(value),
    "sampling_interval": SAMPLING_INTERVAL.check,
    "sound_speed": SOUND_SPEED.check,
    "upsampling": lambda field, value: checks.check_integer(field, value, 1, 16),
    "time_zero": TIME_ZERO.check,
    "time_padding": _padding,
    "lateral_padding": lambda field, value: value if value is None else _padding(field, value),
    "highest_frequency": _highest,
    "memory_limit": _limit,
    "device": _one_of(get_args(Device)),
    "device_memory": _limit,
}
