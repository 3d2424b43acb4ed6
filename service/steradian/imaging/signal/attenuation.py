"""Attenuation of A-lines as one matrix over time, and its regularised inverse.

In a homogeneous medium with the complex wave number K(ω) the attenuated A-line is a linear image of the one without
attenuation, the same for every sensor and object (P. J. La Rivière, J. Zhang and M. A. Anastasio, Opt. Lett. 31, 781,
2006; F. Natterer's and R. Kowar's later proofs hold for the power law, too):

    p_att(t) = 1/2π ∫ ω/(cK) Σ_τ p(τ)·e^{icKτ}·e^{−iωt} dω

So it is a matrix M (N_t, N_t) of the times t and τ, whose adjoint is its transpose. For the sound of a layer below
others the exponent icKτ is the sum over the layers that sound along the normal crosses within τ. That is exact for
sound along the normal. For sound at an angle the layers above have a little less of the path than they really have.

The inverse is Tikhonov's, R = L·(MᵀM + λ²)⁻¹Mᵀ: it amplifies the more, the later a sample is, and nothing by more than
1/(2λ). λ and the low-pass filter L follow from the noise (:meth:`Compensation.restoration`).
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging import validation as checks
from steradian.imaging.attenuation import Attenuation
from steradian.imaging.medium import Medium
from steradian.imaging.signal.bandwidth import signal_band
from steradian.imaging.volume import RealArray

Floats = NDArray[np.float64]
LOSSLESS = Attenuation(0.0, 1.0)
_BLOCK = 128  # columns of the matrix made together
MIN_STRENGTH, MAX_STRENGTH = 1e-3, 1.0
"""Bounds of λ: of records without noise, and of those without signal."""
PASSED = 1.3
"""End of the low-pass filter's pass band, in ends of the signal's band: images average sensors, and hear beyond it."""
_SLOPE = 0.25  # of the filter, in ends of its pass band
_STEPS = 8  # strengths and frequencies a factor of two, of which the inverse is kept


def attenuation_matrix(medium: Medium, *, samples: int, interval: float, time_zero: float) -> Floats:
    """Return the matrix M (N_t, N_t) from lossless A-lines to attenuated ones, as columns of samples.

    Parameters
    ----------
    medium
        Layers, some with an attenuation; sound comes from the last one (:attr:`.medium.LayerPath.medium`).
    samples, interval, time_zero
        N_t, sampling interval and time of the first sample after the pulse in s. What is before it stays as it is.
    """
    omega, excess = _excess(medium, samples, interval)
    amplitude = omega / (omega + excess[-1])
    spent = _times_in_layers(medium, _times(samples, interval, time_zero))

    def spectra(some: slice) -> NDArray[np.complex128]:
        return np.asarray(amplitude * np.exp(1j * (spent[some] @ excess)))

    return _matrix(samples, spectra)


def attenuation_derivatives(
    medium: Medium, *, samples: int, interval: float, time_zero: float
) -> tuple[Floats, Floats]:
    """Return the derivatives of :func:`attenuation_matrix` by sound speed and by time zero, for one layer."""
    (layer,) = medium.layers
    omega, (excess,) = _excess(medium, samples, interval)
    amplitude = omega / (omega + excess)
    (spent,) = _times_in_layers(medium, _times(samples, interval, time_zero)).T

    def by_speed(some: slice) -> NDArray[np.complex128]:
        path = spent[some, None] * excess
        return np.asarray(amplitude * np.exp(1j * path) * (1j * path - excess / (omega + excess)) / layer.sound_speed)

    def by_time(some: slice) -> NDArray[np.complex128]:
        after = spent[some, None] > 0
        return np.asarray(amplitude * np.exp(1j * spent[some, None] * excess) * (1j * excess * after))

    return _matrix(samples, by_speed), _matrix(samples, by_time)


def _times(samples: int, interval: float, time_zero: float) -> Floats:
    begins = round(time_zero / interval, 9)
    return np.asarray((begins + np.arange(samples, dtype=np.float64)) * interval)


def _excess(medium: Medium, samples: int, interval: float) -> tuple[Floats, NDArray[np.complex128]]:
    """Return ω (F,), and c·K − ω of each layer (L, F)."""
    f = np.arange(samples + 1) / (2 * samples * interval)
    f[0] = f[1] / 2  # K(0) may not exist; the mean of sound is 0
    excess = np.array([each.sound_speed * (each.attenuation or LOSSLESS).excess(f) for each in medium.layers])
    return 2 * np.pi * f, excess


def _matrix(samples: int, spectra: Callable[[slice], NDArray[np.complex128]]) -> Floats:
    """Return the matrix of which some columns τ have these spectra (τ, F), each about its own place."""
    found = np.empty((samples, samples))
    for first in range(0, samples, _BLOCK):
        # about its own place, so that phases are those of the excess alone
        spectrum = np.conj(spectra(slice(first, first + _BLOCK)))
        spectrum[:, -1] = spectrum[:, -1].real
        for column, line in enumerate(np.fft.irfft(spectrum, 2 * samples, axis=1), start=first):
            found[:, column] = np.roll(line, column)[:samples]
    return found


def _times_in_layers(medium: Medium, times: Floats) -> Floats:
    """Return the time (N_t, L) that sound along the normal spends in each layer."""
    thickness = [np.inf if each.thickness is None else each.thickness for each in medium.layers]
    crossing = np.array([d / each.sound_speed for d, each in zip(thickness, medium.layers, strict=True)])
    nearer = np.concatenate([[0.0], np.cumsum(crossing)[:-1]])
    spent: Floats = np.clip(times[:, None] - nearer, 0.0, crossing)
    return spent


def compensation_bytes(samples: int) -> int:
    """Return an upper bound of the memory in bytes that a :class:`Compensation` of N_t samples takes while in use."""
    return 6 * 8 * samples**2


class Restoration(NamedTuple):
    """Regularised inverse of an attenuation matrix for records of one noise.

    Parameters
    ----------
    matrix
        R (N_t, N_t).
    strength
        λ.
    noise_gain
        (N_t,) standard deviation of the result's noise at each time over that of white noise in the A-lines: the norms
        of R's rows. Below 1 where the low-pass filter takes more than the inverse amplifies.
    """

    matrix: Floats
    strength: float
    noise_gain: Floats


class Compensation:
    """Regularised inverse of an attenuation matrix, for A-lines of any noise.

    The eigenvalues of MᵀM are computed once, in some 10·N_t³ operations (0.3 s for 1,024 samples), and kept with two
    matrices (N_t, N_t). A record whose noise differs costs N_t³ multiplications, and each A-line N_t².

    Parameters
    ----------
    medium, samples, interval, time_zero
        As in :func:`attenuation_matrix`.

    Attributes
    ----------
    held
        Inverse to use for all A-lines (:meth:`hold`); None: each record's own.
    """

    def __init__(self, medium: Medium, *, samples: int, interval: float, time_zero: float) -> None:
        self._interval = interval
        matrix = attenuation_matrix(medium, samples=samples, interval=interval, time_zero=time_zero)
        self._squares, self._vectors = np.linalg.eigh(matrix.T @ matrix)
        self._images: Floats = matrix @ self._vectors
        self._kept: tuple[tuple[float, float], Restoration] | None = None
        self.held: Restoration | None = None

    def hold(self, traces: RealArray, *, noise: float, highest: float) -> None:
        """Keep the inverse for these A-lines as :attr:`held`; parameters as in :meth:`restoration`."""
        self.held = self.restoration(traces, noise=noise, highest=highest)

    def restoration(
        self, traces: RealArray, *, noise: float | None = None, highest: float | None = None
    ) -> Restoration:
        """Return the inverse for A-lines (M, N_t) of white noise σ: λ = √(σ√B/(p·√M)).

        p is the largest sample and B the share of the signal's band of all frequencies up to Nyquist's. A wave that
        arrives with the share λ of its amplitude is amplified by 1/(2λ), and an image averages M sensors. So the noise
        added to the image is at most λ/2 of the loudest pulse, and of waves that arrive with more than λ less than half
        is missing. The filter passes 1.3 times the signal's band.

        Parameters
        ----------
        traces
            A-lines, attenuated.
        noise
            Standard deviation σ of a sample; None: read from above the signal's band.
        highest
            End of the signal's band in Hz; None: read from the A-lines.

        Raises
        ------
        InvalidInput
            If a sample is not finite.
        """
        largest = float(np.abs(traces).max(initial=0.0))
        if not np.isfinite(largest):
            raise InvalidInput("traces", checks.describe_non_finite(traces), "finite numbers")
        band, sigma = signal_band(traces, self._interval)
        noise, highest = sigma if noise is None else noise, band if highest is None else highest
        share = min(1.0, 2 * highest * self._interval)
        strength = MAX_STRENGTH
        if largest > 0:
            strength = sqrt(noise * sqrt(share) / (largest * sqrt(len(traces))))
        key = _rounded(float(np.clip(strength, MIN_STRENGTH, MAX_STRENGTH))), _rounded(PASSED * highest)
        kept = self._kept  # another thread may replace it
        if kept is None or kept[0] != key:
            kept = self._kept = key, self._inverse(*key)
        return kept[1]

    def _inverse(self, strength: float, passed: float) -> Restoration:
        matrix = (self._vectors / (self._squares + strength**2)) @ self._images.T
        count = len(matrix)
        f = np.arange(count + 1) / (2 * count * self._interval)
        low_pass = np.cos(0.5 * np.pi * np.clip((f / passed - 1) / _SLOPE, 0, 1)) ** 2
        spectrum = np.fft.rfft(matrix, 2 * count, axis=0) * low_pass[:, None]
        matrix = np.ascontiguousarray(np.fft.irfft(spectrum, 2 * count, axis=0)[:count])
        return Restoration(matrix, strength, np.asarray(np.linalg.norm(matrix, axis=1)))


def _rounded(value: float) -> float:
    return float(2.0 ** (round(_STEPS * np.log2(value)) / _STEPS))
