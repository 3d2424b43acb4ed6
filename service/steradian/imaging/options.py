"""Options of a reconstruction: image grid, direct methods, and execution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, ClassVar, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import DTypeLike

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH, MODES, PADDING, TOLERANCE, UPSAMPLING, as_finite_float
from steradian.imaging import validation as checks
from steradian.imaging.film_response import InverseFilter
from steradian.imaging.transforms.windows import Shape, Window

Device: TypeAlias = Literal["auto", "cpu", "gpu"]
Precision: TypeAlias = Literal["float32", "float64"]


@dataclass(frozen=True)
class ImageGrid:
    """Voxel grid of a reconstruction.

    Parameters
    ----------
    modes
        Lateral image points N over the aperture, one number or (Nx, Ny). More than the sensors' own sampling sharpen
        the image, because the spectrum of a grid of sensors repeats and κ separates the repetitions.
    depth
        First and last depth in metres, within 0 … c·(``t0`` + N_t·``dt``); only these slices are computed in the last
        step. None: from 0 to the end of the record; if the record begins later after the pulse than a quarter of its
        length, from c·``t0`` (sources nearer than that reach only sensors far enough to their side).
    depth_step
        Largest distance of slices in metres; the actual one is the next smaller one that divides the depth. None: that
        of samples, c·``dt``, or with a ``max_frequency`` of the method the largest that holds this band. A method
        :class:`steradian.Iterative` does not take it.
    upsampling
        Image points per mode: sinc interpolation of the finished image, for display.
    lateral_padding
        Factor by which the aperture is extended with zeros against sources outside it; the image's points stay where
        they are. None: 1, and for :class:`steradian.Iterative` and forward models as much as keeps periodic copies of
        the volume out of the record.
    time_padding
        Factor by which the record is extended with zeros against deep reflectors that fold back. Records whose length
        has a prime factor above 127 get a few zeros more. :class:`steradian.Iterative` does not take it.

    Raises
    ------
    InvalidInput
        If a number is out of range.
    """

    modes: int | Sequence[int]
    _: KW_ONLY
    depth: tuple[float, float] | None = None
    depth_step: float | None = None
    upsampling: int = 1
    lateral_padding: float | None = None
    time_padding: float = 1.0

    def __post_init__(self) -> None:
        number: Any = self.modes
        if isinstance(number, str | bytes) or np.ndim(number) == 0:
            modes: int | tuple[int, ...] = MODES.check_integer("modes", number)
        else:
            modes = tuple(MODES.check_integer("modes", each) for each in number)
        _set(self, "modes", modes)
        if self.depth is not None:
            _set(self, "depth", checks.depth_pair(self.depth))
        if self.depth_step is not None:
            _set(self, "depth_step", LENGTH.check("depth_step", self.depth_step))
        _set(self, "upsampling", UPSAMPLING.check_integer("upsampling", self.upsampling))
        if self.lateral_padding is not None:
            _set(self, "lateral_padding", PADDING.check("lateral_padding", self.lateral_padding))
        _set(self, "time_padding", PADDING.check("time_padding", self.time_padding))

    def require_defaults(self, method: str, *names: str) -> None:
        """Raise :class:`InvalidInput` if one of the options ``names``, which ``method`` ignores, is not default."""
        for name in names:
            value, default = getattr(self, name), getattr(type(self), name)
            if value != default:
                shown = f"{default:g}" if isinstance(default, float) else default
                raise InvalidInput(name, value, f"{shown} with {method}, which uses no other")


@dataclass(frozen=True, kw_only=True)
class DirectMethod:
    """Base class of the direct methods; their images are computed in one pass.

    Parameters
    ----------
    tolerance
        Relative l2 error of the image's spectrum against the direct sums; determines window and grids.
    window
        Shape of the interpolation window, whose width follows from the tolerance; or a window of given width and
        oversampling such as the paper's ``kaiser_bessel(6, 2.0)``.
    max_frequency
        Upper end in Hz of the band that is used, at least 2 cycles a record: κ ends there. The run then costs about
        its share of the Nyquist frequency, because slices are as far apart as the band allows. "signal": where the
        A-lines' signal ends in noise, for :func:`steradian.reconstruct` only; None: the Nyquist frequency.
    correction
        Inverse filter of the film's response; None: an ideal sensor.

    Raises
    ------
    InvalidInput
        If a value is out of range.
    """

    name: ClassVar[str]
    """Name of the method in reports, files and the HTTP API."""

    tolerance: float = 1e-4
    window: Shape | Window = "kaiser-bessel"
    max_frequency: float | Literal["signal"] | None = None
    correction: InverseFilter | None = None

    def __post_init__(self) -> None:
        _set(self, "tolerance", TOLERANCE.check("tolerance", self.tolerance))
        check_window("window", self.window)
        _set(self, "max_frequency", check_max_frequency(self.max_frequency))
        check_correction(self.correction)


class Nufft(DirectMethod):
    """NEDNER method: non-uniform FFT in frequency and space for arbitrary sensor positions, with exact κ.

    Sensors that are all on a grid, or on a part of one, are transformed without interpolation in space
    (:class:`Ner`). Parameters as in :class:`DirectMethod`.
    """

    name = "nedner"


class Ner(DirectMethod):
    """NER method: non-uniform FFT in frequency for sensors on a grid, with exact κ.

    Parameters as in :class:`DirectMethod`.
    """

    name = "ner"


class LinearKappa(DirectMethod):
    """FFT method with linear interpolation in frequency, as in k-Wave; parameters as in :class:`DirectMethod`.

    The record is doubled with zeros first.
    """

    name = "linear"


class NearestKappa(DirectMethod):
    """FFT method with the nearest frequency to κ, as in k-Wave; parameters as in :class:`DirectMethod`.

    The record is doubled with zeros first.
    """

    name = "nearest"


class Gridded(DirectMethod):
    """NER method on A-lines interpolated linearly to a grid; parameters as in :class:`DirectMethod`.

    The grid is that of the sensors, or that of the modes. Weights are not used.
    """

    name = "interpolated"


DIRECT_METHODS: dict[str, type[DirectMethod]] = {
    kind.name: kind for kind in (Nufft, Ner, LinearKappa, NearestKappa, Gridded)
}
"""Direct methods by their name."""


@dataclass(frozen=True, kw_only=True)
class Compute:
    """Execution options (device, precision, threads, memory), which change the image only within the tolerance.

    Parameters
    ----------
    device
        "cpu"; "gpu": a CUDA device (extra ``gpu``); "auto": a CUDA device if there is one whose memory suffices, else
        the CPU.
    dtype
        Working precision and that of the image, float32 or float64. None: float32, or float64 for a tolerance below
        5e-6.
    threads
        Largest number of threads; None: all processors that this process may use, or ``OMP_NUM_THREADS``.
    memory_limit
        Largest amount of memory in bytes, image included, checked before the start; None: what is available.
    device_memory
        Largest amount of GPU memory in bytes; None: nine tenths of what is free. Larger images are computed in pieces.

    Raises
    ------
    InvalidInput
        If a value is out of range.
    """

    device: Device = "auto"
    dtype: DTypeLike | None = None
    threads: int | None = None
    memory_limit: int | None = None
    device_memory: int | None = None

    def __post_init__(self) -> None:
        checks.check_choice("device", self.device, get_args(Device))
        if self.dtype is not None:
            _set(self, "dtype", checks.precision_name(self.dtype))
        if self.threads is not None:
            _set(self, "threads", checks.thread_count(self.threads))
        for name in ("memory_limit", "device_memory"):
            if getattr(self, name) is not None:
                as_finite_float(name, getattr(self, name), "bytes, or None")

    def precision(self, tolerance: float) -> Precision:
        """Return the working precision for a tolerance; raises :class:`InvalidInput` if float32 does not suffice."""
        return checks.working_precision(self.dtype, tolerance)

    @property
    def max_threads(self) -> int:
        """Largest number of threads."""
        return checks.thread_count(self.threads)


def require_direct(method: object, more: str) -> None:
    """Raise :class:`InvalidInput` for other than a direct method; ``more`` extends the message's allowed values."""
    if not isinstance(method, DirectMethod):
        allowed = ", ".join(kind.__name__ for kind in DIRECT_METHODS.values()) + more
        raise InvalidInput("method", type(method).__name__, allowed)


def check_window(field: str, value: object) -> None:
    """Raise :class:`InvalidInput` unless the value is a window shape or a :class:`Window`."""
    if not isinstance(value, Window):
        checks.check_choice(field, value, get_args(Shape), ", or a Window")


def check_correction(value: object) -> None:
    """Raise :class:`InvalidInput` unless the value is an :class:`InverseFilter` or None."""
    if not isinstance(value, InverseFilter | None):
        raise InvalidInput("correction", type(value).__name__, "an InverseFilter, or None")


def check_max_frequency(value: Any) -> Any:
    """Return the validated upper frequency: Hz, "signal" or None."""
    allowed = 'a frequency above 0 Hz, "signal" or None'
    if isinstance(value, str | None):
        if value not in ("signal", None):
            raise InvalidInput("max_frequency", value, allowed)
        return value
    number = as_finite_float("max_frequency", value, allowed)
    if number <= 0:
        raise InvalidInput("max_frequency", value, allowed)
    return number


def _set(value: object, name: str, checked: object) -> None:
    object.__setattr__(value, name, checked)
