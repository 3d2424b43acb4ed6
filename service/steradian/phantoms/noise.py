"""White noise at a signal-to-noise ratio with an explicit definition (peak or RMS)."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput

SnrConvention = Literal["peak", "rms"]


def add_noise(
    traces: ArrayLike, decibels: float, *, convention: SnrConvention = "peak", seed: int = 0
) -> NDArray[np.float32]:
    """Add white Gaussian noise of a given signal-to-noise ratio to A-lines.

    Parameters
    ----------
    traces
        A-lines (M, N_t).
    decibels
        Signal over the noise's standard deviation, 20·log₁₀.
    convention
        What counts as the signal: the largest absolute value of all traces ("peak"), or their root mean square over
        all samples, empty ones included ("rms", as k-Wave's addNoise does). For sparse signals the same number of
        decibels means far less noise by the second.
    seed
        The noise is the same for the same seed and shape.

    Returns
    -------
    ndarray
        (M, N_t) float32.

    Raises
    ------
    InvalidInput
        When the convention is unknown.
    """
    clean = np.asarray(traces, dtype=np.float32)
    if convention not in get_args(SnrConvention):
        raise InvalidInput("convention", convention, ", ".join(get_args(SnrConvention)))
    square = np.square(clean, dtype=np.float64)
    signal = float(np.sqrt(square.max() if convention == "peak" else square.mean()))
    noise = np.random.default_rng(seed).standard_normal(clean.shape, dtype=np.float32)
    return clean + np.float32(signal * 10 ** (-decibels / 20)) * noise
