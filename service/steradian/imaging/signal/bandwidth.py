"""Signal bandwidth and noise of A-lines; decimation and sinc interpolation."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.engines.array_namespace import is_gpu_array
from steradian.imaging.geometry.reconstruction import MIN_CYCLES
from steradian.imaging.volume import RealArray

_ABOVE = 2.0  # power of signal plus noise against noise alone where the band ends
_FLOOR = 1e-7  # least power against the strongest frequency's, for data without noise
_MARGIN = 1.15  # Nyquist frequency kept against the band's end
_CHUNK = 512  # traces filtered together
_ROWS = 16  # of an image, upsampled together by a thread


def signal_band(traces: RealArray, sampling_interval: float) -> tuple[float, float]:
    """Return the highest frequency with signal, in Hz, and the white noise's standard deviation a sample.

    The noise is taken from the top quarter of frequencies, where a film's signal has ended; the band ends where the
    mean power of all traces falls below twice the noise's for good.
    """
    samples, power = traces.shape[1], _mean_power(traces)
    width = max(1, len(power) // 64)
    smooth = np.convolve(power, np.ones(width) / width, mode="same")
    noise = float(np.median(power[-max(1, len(power) // 4) :]))
    loud = np.flatnonzero(smooth > max(_ABOVE * noise, _FLOOR * float(smooth.max())))
    last = int(loud[-1]) if loud.size else len(power) - 1
    return float((last + 1) / (samples * sampling_interval)), float(np.sqrt(noise))


def resolve_upper_frequency(
    highest: float | Literal["signal"] | None, traces: RealArray, sampling_interval: float
) -> float | None:
    """Return the upper frequency in Hz, at least two cycles a record; "signal": end of the signal's band.

    Raises
    ------
    InvalidInput
        If the traces are no numbers, or none.
    """
    if not isinstance(highest, str):
        return highest
    if traces.dtype.kind not in "iuf":
        raise InvalidInput("traces", f"an array of {traces.dtype}", "integers or floating numbers")
    if not traces.size:
        raise InvalidInput("traces", f"an array of shape {traces.shape}", "at least one sample")
    least: float = MIN_CYCLES / (traces.shape[1] * sampling_interval)
    return max(signal_band(traces, sampling_interval)[0], least)


def power_fraction_above(frequency: float, traces: RealArray, sampling_interval: float) -> float:
    """Return the fraction of the A-lines' power above a frequency in Hz."""
    power = _mean_power(traces)
    power[1 : (traces.shape[1] + 1) // 2] *= 2  # those of negative frequencies
    above = np.arange(len(power)) / (traces.shape[1] * sampling_interval) >= frequency
    total = float(power.sum())
    return float(power[above].sum()) / total if total > 0 else 0.0


def _mean_power(traces: RealArray) -> NDArray[np.float64]:
    """Return the mean power spectrum |G|²/N_t at non-negative frequencies."""
    samples = traces.shape[1]
    power = np.zeros(samples // 2 + 1)
    for first in range(0, len(traces), _CHUNK):
        spectrum = np.fft.rfft(traces[first : first + _CHUNK], axis=1)
        power += (np.abs(spectrum) ** 2).sum(axis=0)
    power /= len(traces) * samples
    return power


def decimation_factor(highest: float, sampling_interval: float) -> int:
    """Return the integer decimation factor for a band that ends at ``highest``."""
    return max(1, int(0.5 / sampling_interval / (_MARGIN * highest)))


def decimate(traces: RealArray, factor: int, dtype: str, scale: float = 1.0) -> RealArray:
    """Decimate by a low-pass filter to the new Nyquist frequency and every ``factor``-th sample, scaled.

    Zero-padded to a multiple.
    """
    from scipy import fft

    if factor == 1:
        return np.ascontiguousarray(np.multiply(traces, scale, dtype=np.float64), dtype)
    samples = -(-traces.shape[1] // factor)
    result: NDArray[np.floating] = np.empty((len(traces), samples), dtype)
    for first in range(0, len(traces), _CHUNK):
        part = np.multiply(traces[first : first + _CHUNK], scale, dtype=np.float64).astype(dtype)
        # twice as long, so that nothing wraps
        spectrum = fft.rfft(part, 2 * samples * factor, axis=1)[:, : samples + 1]
        spectrum[:, -1] = spectrum[:, -1].real
        result[first : first + _CHUNK] = fft.irfft(spectrum, 2 * samples, axis=1)[:, :samples] / factor
    return result


def sinc_upsample(
    values: RealArray, factors: tuple[int, ...], depths: slice = slice(None), *, threads: int = 1
) -> RealArray:
    """Upsample an image by sinc interpolation: ``factors`` points a voxel along each axis, the first on the voxel.

    Along depth the image is continued with zeros, laterally periodically. Only the refined ``depths`` are made.
    """
    from scipy import fft

    fast: Any = (
        np.fft if is_gpu_array(values) else fft
    )  # of NumPy's functions, that of the array's own library is called
    result = values
    for axis, factor in enumerate(factors):
        kept = depths if axis == result.ndim - 1 else slice(None)
        if factor == 1:
            result = result if kept == slice(None) else np.ascontiguousarray(result[..., kept])
            continue
        count = result.shape[axis]
        length = count if axis < result.ndim - 1 else fft.next_fast_len(count + 64, real=True)
        other = 1 if axis == 0 else 0
        shape = tuple(len(range(n * factor)[kept]) if a == axis else n for a, n in enumerate(result.shape))
        fine: RealArray = np.empty(shape, values.dtype, like=values)
        upsample = partial(_upsample_rows, fast, result, fine, (axis, other), (count, length, factor), kept)
        pieces = -(-result.shape[other] // _ROWS)
        if is_gpu_array(values) or threads == 1:
            for piece in range(pieces):
                upsample(piece)
        else:
            with ThreadPoolExecutor(min(threads, pieces)) as pool:
                list(pool.map(upsample, range(pieces)))
        result = fine
    return result


def _upsample_rows(
    fast: Any, values: RealArray, fine: RealArray, axes: tuple[int, int], sizes: tuple[int, int, int], kept: slice,
    piece: int,
) -> None:  # fmt: skip
    """Upsample some rows of an image along one axis.

    ``axes``: that axis and the one of the rows; ``sizes``: its points, those of its transform, and the factor.
    """
    (axis, other), (count, length, factor) = axes, sizes
    some: list[slice] = [slice(None)] * values.ndim
    some[other] = slice(piece * _ROWS, (piece + 1) * _ROWS)
    spectrum = fast.rfft(values[tuple(some)], length, axis=axis)
    if length % 2 == 0:
        np.moveaxis(spectrum, axis, 0)[-1] *= 0.5
    long = np.moveaxis(fast.irfft(spectrum, length * factor, axis=axis), axis, 0)[: count * factor][kept]
    fine[tuple(some)] = np.moveaxis(long, 0, axis) * values.dtype.type(factor)
