"""Resolution from line-spread and edge-spread fits.

A Lorentzian fitted to the few samples around a maximum reads low on lines that are Gaussian or sinc-like, as images of
a band-limited system are: it trades width for tails. So each fit carries the directly measured width.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.quality.width import find_width, samples

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SpreadFit:
    """Result of a line-spread or edge-spread fit.

    Parameters
    ----------
    fwhm
        Full width at half maximum of the line, or of the line whose edge it is, in the unit of the coordinate.
    standard_error
        Of ``fwhm``, from the fit's covariance.
    direct_fwhm
        Width between the half-maximum crossings of the samples (of their slopes for an edge), without a model;
        not a number where the samples do not fall to a half on both sides.
    centre
        Where the line or edge is.
    height
        Maximum of the fitted line, or step of the fitted edge.
    base
        Level beside the edge, at its lower coordinates; 0 for a line.
    residual
        Root mean square of what the fit leaves, over ``height``.
    """

    fwhm: float
    standard_error: float
    direct_fwhm: float
    centre: float
    height: float
    base: float
    residual: float


def line_spread(z: ArrayLike, intensity: ArrayLike, *, points: int | None = 8) -> SpreadFit:
    """Fit a line-spread function I(z) = 2·a₀·w/(π·(w² + 4·(z − z₀)²)) around the maximum (paper, section 3).

    Parameters
    ----------
    z
        Ascending coordinates (N,), usually metres.
    intensity
        Values (N,).
    points
        Samples around the maximum that the fit sees (the paper's 8 cover 94.74 µm); ``None``: all.

    Returns
    -------
    SpreadFit
        ``direct_fwhm`` uses all the samples.

    Raises
    ------
    InvalidInput
        When there are fewer than 4 samples, the maximum is not positive, or the fit finds no line.
    """
    x, values = samples("z", z, intensity, 4)
    top = int(values.argmax())
    if values[top] <= 0:
        raise InvalidInput("intensity", f"maximum {values[top]:g}", "a line with a positive maximum")
    some = slice(None) if points is None else _around(values, top, points)
    direct = direct_fwhm(x, values)
    width = direct if np.isfinite(direct) else float(np.ptp(x[some])) / 2

    def line(at: Array, w: float, middle: float, height: float) -> Array:
        found: Array = height / (1 + 4 * ((at - middle) / w) ** 2)  # a₀ = π·w·height/2
        return found

    (w, middle, height), error, residual = _fit(line, x[some], values[some], (width, x[top], values[top]))
    return SpreadFit(w, error, direct, middle, height, 0.0, residual)


def edge_spread(x: ArrayLike, intensity: ArrayLike) -> SpreadFit:
    """Fit an edge-spread function I(x) = I₀ + a₀·(arctan((x − x₀)/(w/2))/π + ½) over an edge (paper, section 3).

    Parameters
    ----------
    x
        Ascending coordinates (N,), usually metres, of which the samples cover one edge.
    intensity
        Values (N,), rising or falling.

    Returns
    -------
    SpreadFit
        ``fwhm`` is that of the associated line; ``height`` is negative for a falling edge.

    Raises
    ------
    InvalidInput
        When there are fewer than 5 samples, they are constant, or the fit finds no edge.
    """
    at, values = samples("x", x, intensity, 5)
    step = float(values[-1] - values[0]) or float(np.ptp(values))
    if np.ptp(values) == 0:
        raise InvalidInput("intensity", "constant", "samples across an edge")
    slopes = np.sign(step) * np.diff(values) / np.diff(at)
    between = (at[1:] + at[:-1]) / 2
    direct = direct_fwhm(between, slopes)
    start = direct if np.isfinite(direct) else float(np.ptp(at)) / 5

    def edge(where: Array, w: float, middle: float, height: float, base: float) -> Array:
        found: Array = base + height * (np.arctan(2 * (where - middle) / w) / np.pi + 0.5)
        return found

    middle = between[int(slopes.argmax())]
    (w, middle, height, base), error, residual = _fit(edge, at, values, (start, middle, step, values[0]))
    return SpreadFit(w, error, direct, middle, height, base, residual)


def direct_fwhm(x: ArrayLike, intensity: ArrayLike, *, base: float | None = None) -> float:
    """Return the full width at half maximum without a model, as :func:`steradian.quality.width` defines it.

    Parameters
    ----------
    x
        Ascending coordinates (N,).
    intensity
        Values (N,).
    base
        Level that the peak's height is counted from; ``None``: read from the samples beside the peak.

    Returns
    -------
    float
        In the unit of ``x``; not a number where the samples do not fall to a half on both sides.
    """
    found = find_width(*samples("x", x, intensity, 2), base)
    return float("nan") if found is None else found.fwhm


def _around(values: Array, top: int, points: int) -> slice:
    """Return the ``points`` samples centred best around the maximum."""
    if points < 4:
        raise InvalidInput("points", points, "at least 4 samples")
    later = top + 1 < len(values) and (top == 0 or values[top + 1] >= values[top - 1])
    first = top - (points - 1) // 2 if later or points % 2 else top - points // 2
    first = max(0, min(first, len(values) - points))
    return slice(first, first + points)


def _fit(
    model: Callable[..., Array], x: Array, values: Array, start: tuple[float, ...]
) -> tuple[tuple[float, ...], float, float]:
    """Return the fit parameters, of which the first is the width, its standard error and the relative residual.

    Coordinates and values are scaled to about 1 first, so that metres fit as well as pixels; the width is fitted by its
    logarithm, which keeps it positive.
    """
    from scipy.optimize import OptimizeWarning, curve_fit

    width, origin, height = abs(start[0]), start[1], float(np.abs(values).max())
    # tiny numbers are zero: the fit's steps are relative to what it starts from
    scaled = [0.0, 0.0, *(round(value / height, 6) for value in start[2:])]

    def scaled_model(at: Array, log_width: float, *rest: float) -> Array:
        return model(at, np.exp(log_width), *rest)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", OptimizeWarning)
            warnings.simplefilter("ignore", RuntimeWarning)  # a trial width beyond all bounds
            found, covariance = curve_fit(scaled_model, (x - origin) / width, values / height, scaled, maxfev=600)
    except (RuntimeError, OptimizeWarning) as reason:
        raise InvalidInput("intensity", f"no fit ({reason})", "samples around one line or edge") from reason
    rest = scaled_model((x - origin) / width, *found) - values / height
    residual = float(np.sqrt(np.mean(rest**2)) / abs(found[2])) if found[2] else float("nan")
    fwhm = float(np.exp(found[0])) * width
    parameters = (fwhm, found[1] * width + origin, *(value * height for value in found[2:]))
    error = float(np.sqrt(covariance[0, 0])) * fwhm
    return tuple(float(value) for value in parameters), error, residual
