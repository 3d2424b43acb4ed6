"""Time-to-depth mapping: spectral interpolation at κ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.transforms.grid_sizes import time_grid
from steradian.imaging.transforms.windows import Shape, Window

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class TimeInterpolation:
    """NUFFT over time: interpolation of a record's spectrum at any frequency (paper, NER-NUFFT, equation 5).

    Sample n, times ``divided[n]``, goes to cell (n − ``centre``) mod ``length`` of a transform of that length. At the
    frequency κ (in cycles a record of ``record`` samples) its place is u = κ·length/record; tap t stands at the cell
    ⌊u − w/2⌋ + 1 + t, nearest interpolation's only one at ⌊u + ½⌋.

    Parameters
    ----------
    samples, record
        Of a trace, and N_t of the formula; in new samples where the trace is decimated, of which a record need not last
        a whole number.
    centre, length
        As above.
    divided
        (samples,) one over the window's transform.
    taps
        (w, D + 1) polynomials of the taps in 2·(u − w/2 − ⌊u − w/2⌋) − 1, lowest power first.
    nearest
        No stencil, the nearest frequency.
    """

    samples: int
    record: float
    centre: int
    length: int
    divided: Floats
    taps: Floats
    nearest: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class KappaMap:
    """Dispersion relation: time frequency κ of each depth frequency, with its Jacobian factor.

    Lateral mode j and depth frequency ±l, in cycles a record, come from κ = √(l² + |scales·j|²), if that is below
    ``band``. With X(κ) the transform over time and R the response,

        waves "rising": H(l) = 2l/κ·R(κ)·e^{−2πi·turns·κ}·X(κ), 2 for 2l/κ at κ = 0; H(−l) likewise from X(−κ)
        waves "both":   H(l) = H(−l) = ½·R(κ)·e^{−2πi·turns·κ}·X(κ) + ½·conj(R(κ)·e^{−2πi·turns·κ})·X(−κ)

    The first is the inversion (paper, equation 7), the second the transpose of the wave equation's solution.

    Parameters
    ----------
    scales
        N_t·Δz/X along x and y.
    turns
        Time of cell 0 in records.
    band
        Bound of κ.
    waves
        As above.
    table, steps
        R as :func:`steradian.imaging.film_response.tabulate` gives it.
    overlying, shift
        Layers above: with rows (a, b) of ``overlying``, R(κ) above is multiplied by e^{2πi φ},
        φ = Σ √(a·κ² − b·|scales·j|²) − shift·l, and 0 where a root is imaginary (:mod:`steradian.imaging.medium`).
    """

    scales: tuple[float, float]
    turns: float
    band: float
    waves: Literal["rising", "both"]
    table: Floats
    steps: Floats
    overlying: Floats
    shift: float


def window_interpolation(
    samples: int, record: float, window: Shape | Window, share: float, accuracy: float
) -> TimeInterpolation:
    """Return the time interpolation by a window, to the relative error ``share``; its taps to ``accuracy``."""
    centre = samples // 2
    length, found = time_grid(2 * max(centre, samples - centre), record, window, share)
    divided = 1.0 / found.transform((np.arange(samples) - centre) / length)
    return TimeInterpolation(samples, record, centre, length, divided, found.polynomials(accuracy))


def nearest_or_linear(samples: int, record: int, nearest: bool) -> TimeInterpolation:
    """Return the time interpolation by nearest frequency or linearly, as in k-Wave.

    The transform of the record's even extension, which k-Wave takes, has this spacing of frequencies.
    """
    taps = np.array([[1.0]] if nearest else [[0.5, -0.5], [0.5, 0.5]])
    return TimeInterpolation(samples, record, 0, 2 * record, np.ones(samples), taps, nearest)
