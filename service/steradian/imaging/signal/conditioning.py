"""Preprocessing of A-lines (band-pass, offset removal, apodisation) and postprocessing of images.

The steps run in the order of the fields. Nothing is done by default.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, get_args

import numpy as np
from annotated_types import Ge, Gt, Interval
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import TIME_ZERO
from steradian.drawing.style import ColourMap
from steradian.imaging.volume import RealArray, Volume

_CHUNK = 2048  # A-lines filtered at a time, which bounds the memory


@dataclass(frozen=True, slots=True)
class Conditioning:
    """Preprocessing options of A-lines: offset removal, band-pass, deconvolution, apodisation.

    Parameters
    ----------
    zero_first
        Number of first samples set to zero (laser pick-up).
    remove_offset
        Subtract each A-line's mean (of the samples not zeroed).
    remove_common
        Subtract the part common to all A-lines (parasitic signal): their median or mean, sample by sample.
    rim
        Width in metres of the rim of the aperture over which the A-lines fade to zero (edge waves); a raised cosine.
    band
        Lowest and highest frequency in Hz that pass; 0 or None leaves that side open. The edges are raised cosines a
        tenth of the frequency wide; the phase is not changed.
    response
        A filter of your own: (frequencies in Hz rising, gain), interpolated linearly, constant beyond its ends. A
        complex gain changes the phase.
    delay
        Trigger delay in seconds: how long after the laser pulse the first sample was taken, added to ``time_zero``.
    """

    zero_first: Annotated[int, Ge(0)] = 0
    remove_offset: bool = False
    remove_common: Literal["median", "mean"] | None = None
    rim: Annotated[float, Ge(0)] = 0.0
    band: tuple[float | None, float | None] | None = None
    response: tuple[Sequence[float], Sequence[complex]] | None = None
    delay: float = 0.0

    def __post_init__(self) -> None:
        if int(self.zero_first) != self.zero_first or self.zero_first < 0:
            raise InvalidInput("zero_first", self.zero_first, "a whole number of samples from 0")
        if self.remove_common not in (None, "median", "mean"):
            raise InvalidInput("remove_common", self.remove_common, "median, mean or None")
        if not (np.isfinite(self.rim) and self.rim >= 0):
            raise InvalidInput("rim", self.rim, "a width from 0 m")
        TIME_ZERO.check("delay", self.delay)
        if self.band is not None:
            low, high = (float(b or 0.0) for b in self.band)
            if not np.isfinite([low, high]).all() or low < 0 or high < 0 or (high and high <= low):
                raise InvalidInput("band", self.band, "two rising frequencies in Hz, 0 or None for an open side")
        if self.response is not None:
            frequencies, gains = (np.asarray(v) for v in self.response)
            if frequencies.ndim != 1 or frequencies.shape != gains.shape or not (np.diff(frequencies) > 0).all():
                raise InvalidInput("response", self.response, "rising frequencies in Hz and as many gains")

    def apply(
        self,
        traces: ArrayLike,
        positions: ArrayLike | None = None,
        *,
        sampling_interval: float,
        aperture: float | tuple[float, ...] | None = None,
        scale: float = 1.0,
    ) -> NDArray[np.float32]:
        """Return the preprocessed A-lines.

        Parameters
        ----------
        traces
            Shape (M, N_t), not changed.
        positions, aperture
            Sensors in metres, shape (M, d−1), and side lengths; needed for ``rim`` only.
        sampling_interval
            dt in seconds.
        scale
            Factor of the traces (pressure per count).

        Returns
        -------
        ndarray
            New traces, float32, shape (M, N_t).

        Raises
        ------
        InvalidInput
            If a step lacks what it needs or does not fit the record.
        """
        data = np.array(traces, np.float32)
        if data.ndim != 2:
            raise InvalidInput("traces", f"an array of shape {data.shape}", "shape (M, N_t): one row a sensor")
        if self.zero_first >= data.shape[1]:
            raise InvalidInput("zero_first", self.zero_first, f"fewer than the {data.shape[1]} samples of an A-line")
        data *= np.float32(scale)
        live = data[:, self.zero_first :]
        data[:, : self.zero_first] = 0
        if self.remove_offset:
            live -= live.mean(axis=1, keepdims=True)
        if self.remove_common is not None:
            live -= np.median(live, axis=0) if self.remove_common == "median" else live.mean(axis=0)
        if self.rim > 0:
            if positions is None or aperture is None:
                raise InvalidInput("rim", self.rim, "0 unless positions and aperture are given")
            data *= rim_weights(positions, aperture, self.rim)[:, None].astype(np.float32)
        if self.band is not None or self.response is not None:
            gain = self.gain(np.fft.rfftfreq(2 * data.shape[1], sampling_interval))
            _filter(data, gain)
        return data

    def gain(self, frequencies: RealArray) -> NDArray[Any]:
        """Return the filter gain (band-pass and response) at frequencies in Hz."""
        gain: NDArray[Any] = np.ones(len(frequencies))
        if self.band is not None:
            low, high = (float(b or 0.0) for b in self.band)
            if low > 0:
                gain = gain * _step((frequencies - low) / (0.1 * low))
            if high > 0:
                gain = gain * _step((high - frequencies) / (0.1 * high))
        if self.response is not None:
            at, values = np.asarray(self.response[0], np.float64), np.asarray(self.response[1])
            gain = gain * np.interp(frequencies, at, values)
        return gain


def rim_weights(positions: ArrayLike, aperture: float | tuple[float, ...], width: float) -> NDArray[np.float64]:
    """Return raised-cosine apodisation weights (M,): 1 inside, 0 at the aperture's sides, over ``width`` metres."""
    x = np.asarray(positions, np.float64)
    x = x[:, None] if x.ndim == 1 else x
    inside = np.asarray(aperture, np.float64) / 2 - np.abs(x)
    return np.asarray(np.prod(np.sin(np.pi / 2 * np.clip(inside / width, 0, 1)) ** 2, axis=1))


def _step(x: RealArray) -> NDArray[np.float64]:
    """Return a raised-cosine step: 0 below −1/2, 1 above 1/2."""
    return np.asarray(np.sin(np.pi / 2 * np.clip(x + 0.5, 0, 1)) ** 2)


def _filter(data: NDArray[np.float32], gain: NDArray[Any]) -> None:
    """Filter the rows in place by FFT, zero-padded to twice their length to avoid wrap-around."""
    from scipy import fft

    samples = data.shape[1]
    for first in range(0, len(data), _CHUNK):
        part = data[first : first + _CHUNK]
        spectrum = fft.rfft(part, 2 * samples, axis=1) * gain.astype(np.result_type(gain.dtype, np.float32), copy=False)
        part[:] = fft.irfft(spectrum, 2 * samples, axis=1)[:, :samples]


@dataclass(frozen=True, slots=True)
class Display:
    """Postprocessing options of a finished image for display.

    Parameters
    ----------
    gain_db_per_mm
        Time-gain compensation: decibels a millimetre of depth.
    envelope
        Magnitude of the analytic signal along depth.
    log_range_db
        Logarithmic compression: values become decibels below the maximum, cut at −``log_range_db``. None: linear.
    non_negative
        Negative values, which initial pressure does not have but a limited view leaves, become 0.
    near_field
        Depth in metres from which on pictures show the image. None: where the sensors' own noise no longer stands
        out, found from mask and image; 0: everything.
    percentile
        Pictures' colours reach up to this percentile of a projection's values, but at least to half its maximum.
    colour_map
        Colours of pressure in pictures: inferno, magma, viridis, cividis, gray or hot.
    scale_bar
        Length in metres of the bar in pictures; None: a round one; 0: no bar.
    size
        Longest side in pixels of what pictures show.
    """

    gain_db_per_mm: float = 0.0
    envelope: bool = False
    log_range_db: Annotated[float, Gt(0)] | None = None
    non_negative: bool = False
    near_field: Annotated[float, Interval(ge=0, le=1)] | None = None
    percentile: Annotated[float, Interval(ge=50, le=100)] = 99.9
    colour_map: ColourMap = "inferno"
    scale_bar: Annotated[float, Interval(ge=0, le=1)] | None = None
    size: Annotated[int, Interval(ge=60, le=4096)] = 720

    def __post_init__(self) -> None:
        if not np.isfinite(self.gain_db_per_mm):
            raise InvalidInput("gain_db_per_mm", self.gain_db_per_mm, "a finite number of dB/mm")
        if self.log_range_db is not None and not (np.isfinite(self.log_range_db) and self.log_range_db > 0):
            raise InvalidInput("log_range_db", self.log_range_db, "a range above 0 dB, or None")
        for name in ("near_field", "scale_bar"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and 0 <= value <= 1):
                raise InvalidInput(name, value, "0 to 1 m, or None")
        if not 50 <= self.percentile <= 100:
            raise InvalidInput("percentile", self.percentile, "50 to 100")
        if self.colour_map not in get_args(ColourMap):
            raise InvalidInput("colour_map", self.colour_map, ", ".join(get_args(ColourMap)))
        if not 60 <= self.size <= 4096:
            raise InvalidInput("size", self.size, "60 to 4096 pixels")

    @property
    def changes_values(self) -> bool:
        """Whether the display changes voxel values: gain, envelope, logarithm or non-negativity."""
        return bool(self.gain_db_per_mm or self.envelope or self.log_range_db is not None or self.non_negative)

    def apply(self, volume: Volume) -> Volume:
        """Return a postprocessed volume of the same shape and coordinates."""
        values: RealArray = np.array(volume.values)
        if self.gain_db_per_mm:
            values *= (10 ** (self.gain_db_per_mm * volume.axes.z * 1e3 / 20)).astype(values.dtype)
        if self.envelope:
            from scipy.signal import hilbert

            for i in range(values.shape[0]):
                values[i] = np.abs(hilbert(values[i], axis=-1))
        if self.non_negative:
            np.maximum(values, 0, out=values)
        if self.log_range_db is not None:
            size = np.abs(values)
            top = float(size.max()) or 1.0
            floor = 10 ** (-self.log_range_db / 20)
            values = (20 * np.log10(np.maximum(size / top, floor))).astype(values.dtype)
        return replace(volume, values=values)
