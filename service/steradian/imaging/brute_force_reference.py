"""Brute-force float64 evaluation of the reconstruction sums, used as accuracy reference.

The spectrum F(j, l) of the image by the paper's equation for non-equispaced sensors, term by term:

    κ(j, l) = √(l² + Σ_i (N_t·c·dt/X_i)²·j_i²)
    F(j, l) = (2l/κ) Σ_n e^{−2πi κ (n + t0/dt)/N_t} Σ_m (h_m/ΠΔx_i) e^{−2πi j·x_m/X} g[m, n]

with F = 0 where κ ≥ N_t/2, and the limit 2l/κ = 2 at j = 0, l = 0. N_t is the padded record length.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.imaging.geometry.sensor_areas import sensor_areas


def direct_spectrum(
    traces: ArrayLike,
    positions: ArrayLike,
    j: ArrayLike,
    l: ArrayLike,  # noqa: E741
    *,
    sampling_interval: float,
    sound_speed: float,
    aperture: float | Sequence[float],
    modes: int | Sequence[int],
    weights: ArrayLike | None = None,
    record: int | None = None,
    time_zero: float = 0.0,
) -> NDArray[np.complex128]:
    """Return the image's spectrum F at chosen modes (j, l), by direct summation in float64 (reference).

    Parameters
    ----------
    traces
        Shape (M, N_t).
    positions
        Shape (M, d−1) in metres, or (M,) in 2-D.
    j
        Lateral indices, shape (P, d−1) or (P,) in 2-D, each in −N/2 … N/2−1.
    l
        Depth indices, shape (P,), l ≥ 0.
    sampling_interval, sound_speed
        dt in s and c in m/s.
    aperture, modes
        Lateral period X in metres and number of modes N, one number or one an axis.
    weights
        h_m, shape (M,) in m^(d−1); None: areas of the sensors' cells, as in the reconstruction.
    record
        N_t of the formula if the traces are padded with zeros to more samples than they have.
    time_zero
        Time of the first sample in s.

    Returns
    -------
    ndarray
        F, shape (P,).
    """
    g = np.asarray(traces, np.float64)
    count, samples = g.shape
    x = np.asarray(positions, np.float64).reshape(count, -1)
    d = x.shape[1]
    jj = np.asarray(j, np.float64).reshape(-1, d)
    ll = np.asarray(l, np.float64).reshape(-1)
    period = np.broadcast_to(np.asarray(aperture, np.float64), (d,))
    number = np.broadcast_to(np.asarray(modes, np.float64), (d,))
    h = sensor_areas(x, tuple(period)) if weights is None else np.asarray(weights, np.float64)
    length = samples if record is None else record
    kappa = np.sqrt(ll**2 + ((length * sampling_interval * sound_speed / period * jj) ** 2).sum(axis=1))
    scaled = h / float(np.prod(period / number))
    times = np.arange(samples) + time_zero / sampling_interval
    result = np.zeros(len(ll), np.complex128)
    for p in range(len(ll)):
        if kappa[p] >= length / 2:
            continue
        lateral = np.exp(-2j * np.pi * (x / period) @ jj[p]) * scaled
        series = lateral @ g
        factor = 2.0 if kappa[p] == 0 else 2.0 * ll[p] / kappa[p]
        result[p] = factor * (np.exp(-2j * np.pi * kappa[p] * times / length) @ series)
    return result


def spectrum_of(values: ArrayLike, j: ArrayLike, l: ArrayLike) -> NDArray[np.complex128]:  # noqa: E741
    """Return the spectrum F(j, l) of a finished image [x, (y,) z] with the modes' own sampling.

    Valid for 1 ≤ l < N_t/2. The image's point N//2 along each lateral axis is x = 0.
    """
    image = np.asarray(values, np.float64)
    axes = tuple(range(image.ndim - 1))
    spectrum = np.fft.rfftn(np.fft.ifftshift(image, axes=axes))
    jj = np.asarray(j, np.int64).reshape(-1, image.ndim - 1)
    found: NDArray[np.complex128] = spectrum[
        (*(jj[:, a] % image.shape[a] for a in axes), np.asarray(l, np.int64).reshape(-1))
    ]
    return found
