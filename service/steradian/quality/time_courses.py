"""Time courses: a step or an exponential change fitted to values over time, and temporal signal-to-noise ratio."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.volume import Volume

Floats = NDArray[np.float64]
CourseModel: TypeAlias = Literal["step", "exponential"]
FEWEST = {"step": 5, "exponential": 6}
"""Fewest values of a fit: two more than parameters."""


@dataclass(frozen=True)
class TimeCourseFit:
    """Change fitted to a time course: baseline + amplitude·f(t), with f = 0 before ``time``.

    After it, f is 1 for a step and 1 − e^{−(t − time)/time_constant} for an exponential.

    Parameters
    ----------
    model
        "step" or "exponential".
    baseline, amplitude
        Value before the change, and the change; in the unit of the values.
    time
        Begin of the change in s.
    time_constant
        Time constant in s; None for a step.
    baseline_error, amplitude_error, time_error, time_constant_error
        Standard errors (68 %), from the residuals; None for that of a step's time constant.
    residual
        Standard deviation of the residuals.
    residual_of_constant
        Standard deviation of the values about their mean, which the change explains in part.
    """

    model: CourseModel
    baseline: float
    baseline_error: float
    amplitude: float
    amplitude_error: float
    time: float
    time_error: float
    time_constant: float | None
    time_constant_error: float | None
    residual: float
    residual_of_constant: float


def fit_time_course(times: ArrayLike, values: ArrayLike, model: CourseModel = "step") -> TimeCourseFit:
    """Fit a step or an exponential change to a time course by least squares.

    A step's time is known to the interval between two values: its expectation and deviation over all intervals are
    given, weighted by their likelihood. The exponential is fitted by :func:`scipy.optimize.curve_fit` from several
    starts.

    Parameters
    ----------
    times
        In s, rising, shape (n,); n at least 5 for a step and 6 for an exponential.
    values
        Values at them, shape (n,).
    model
        "step" or "exponential".

    Raises
    ------
    InvalidInput
        If there are too few values, times do not rise, a value is not finite, or all are equal.
    """
    if model not in FEWEST:
        raise InvalidInput("model", model, ", ".join(FEWEST))
    t, y = np.asarray(times, np.float64), np.asarray(values, np.float64)
    if t.ndim != 1 or t.shape != y.shape or len(t) < FEWEST[model]:
        allowed = f"one value for each of at least {FEWEST[model]} times"
        raise InvalidInput("values", f"shapes {t.shape} and {y.shape}", allowed)
    if not np.isfinite(t).all() or not (np.diff(t) > 0).all():
        raise InvalidInput("times", "not rising", "rising, in s")
    if not np.isfinite(y).all() or not np.ptp(y) > 0:
        raise InvalidInput("values", "equal or not finite", "finite values that change")
    return _step(t, y) if model == "step" else _exponential(t, y)


def _step(t: Floats, y: Floats) -> TimeCourseFit:
    count = len(t)
    cuts = np.arange(1, count)
    sums = np.cumsum(y)[:-1]
    before, after = sums / cuts, (y.sum() - sums) / (count - cuts)
    left = np.sum(y**2) - cuts * before**2 - (count - cuts) * after**2
    best = int(np.argmin(left))
    variance = max(float(left[best]), 1e-24 * float(np.sum(y**2))) / (count - 3)
    gaps, middles = np.diff(t), (t[1:] + t[:-1]) / 2
    likelihood = gaps * np.exp(-np.maximum(left - left[best], 0.0) / (2 * variance))
    share = likelihood / likelihood.sum()
    time = float(share @ middles)
    spread = float(np.sqrt(share @ (gaps**2 / 12 + (middles - time) ** 2)))
    cut = int(cuts[best])
    errors = [float(np.sqrt(variance / n)) for n in (cut, count - cut)]
    return TimeCourseFit(
        model="step",
        baseline=float(before[best]),
        baseline_error=errors[0],
        amplitude=float(after[best] - before[best]),
        amplitude_error=float(np.hypot(errors[0], errors[1])),
        time=time,
        time_error=spread,
        time_constant=None,
        time_constant_error=None,
        residual=float(np.sqrt(variance)),
        residual_of_constant=float(y.std(ddof=1)),
    )


def _exponential(t: Floats, y: Floats) -> TimeCourseFit:
    from scipy.optimize import OptimizeWarning, curve_fit

    span, low, high = float(np.ptp(t)), float(t[0]), float(t[-1])
    least = float(np.diff(t).min()) / 20

    def curve(at: Floats, base: float, height: float, begin: float, constant: float) -> Floats:
        return np.asarray(base - height * np.expm1(-np.maximum(at - begin, 0.0) / constant))

    limits = ([-np.inf, -np.inf, low - span, least], [np.inf, np.inf, high, 20 * span])
    best: tuple[float, Any, Any] | None = None
    import warnings

    for begin in np.linspace(low, high, 6)[:-1]:
        for constant in (span / 20, span / 5, span):
            parts = np.stack([np.ones_like(t), curve(t, 0.0, 1.0, begin, constant)], axis=1)
            base, height = np.linalg.lstsq(parts, y, rcond=None)[0]
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", OptimizeWarning)
                    found, covariance = curve_fit(curve, t, y, (base, height, begin, constant), bounds=limits)
            except RuntimeError:  # no convergence from this start
                continue
            left = float(np.sum((y - curve(t, *found)) ** 2))
            if best is None or left < best[0] * (1 - 1e-9):
                best = left, found, covariance
    if best is None:
        raise InvalidInput("values", "no convergence", "values with an exponential change")
    left, found, covariance = best
    base, height, begin, constant = map(float, found)
    errors = [float(each) for each in np.sqrt(np.maximum(np.diag(covariance), 0.0))]
    return TimeCourseFit(
        "exponential", base, errors[0], height, errors[1], begin, errors[2], constant, errors[3],
        float(np.sqrt(left / (len(t) - 4))), float(y.std(ddof=1)),
    )  # fmt: skip


def temporal_snr(volumes: Iterable[Volume]) -> Volume:
    """Return the temporal signal-to-noise ratio of each voxel: mean over standard deviation of the volumes.

    One volume is in memory at a time. Voxels that do not change have NaN.

    Parameters
    ----------
    volumes
        At least 3 volumes on the same voxels, of one wavelength.

    Raises
    ------
    InvalidInput
        If there are fewer, or shapes differ.
    """
    first: Volume | None = None
    mean = squares = np.zeros(0)
    count = 0
    for volume in volumes:
        values = np.asarray(volume.values, np.float64)
        if first is None:
            first, mean, squares = volume, np.zeros(values.shape), np.zeros(values.shape)
        elif values.shape != mean.shape:
            raise InvalidInput("volumes", f"a shape {values.shape}", f"that of the first, {mean.shape}")
        count += 1
        change = values - mean
        mean += change / count
        squares += change * (values - mean)
    if first is None or count < 3:
        raise InvalidInput("volumes", count, "at least 3 of one wavelength")
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(squares > 0, mean / np.sqrt(squares / (count - 1)), np.nan)
    return Volume(ratio.astype(np.float32), first.axes, first.spacing, first.sound_speed)


def summarise_courses(rows: Sequence[Mapping[str, Any]], model: CourseModel | None = None) -> list[dict[str, Any]]:
    """Return a row for each region and wavelength of a series' table, with its course over time.

    Parameters
    ----------
    rows
        Rows of :meth:`.Series.measure`, with ``name``, ``excitation``, ``time`` and ``mean``.
    model
        Change that is fitted to the means over time; None: none.

    Returns
    -------
    list
        Rows with ``name``, ``excitation``, ``volumes``, ``mean``, ``deviation`` of the volumes' means, and their ratio
        ``temporal_snr``, None for fewer than 3 volumes or no deviation; with a model its fit.

    Raises
    ------
    InvalidInput
        If a model is fitted and times are not known, or as of :func:`fit_time_course`.
    """
    groups: dict[tuple[str, float, str | None], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["name"], row["excitation"], row.get("map")), []).append(row)
    made = []
    for (name, excitation, of_map), part in groups.items():
        means = np.array([row["mean"] for row in part], np.float64)
        deviation = float(means.std(ddof=1)) if len(means) > 1 else None
        ratio = float(means.mean() / deviation) if deviation and len(means) > 2 else None
        about = {"name": name, "excitation": excitation, "volumes": len(part), "mean": float(means.mean())}
        about |= {} if of_map is None else {"map": of_map}
        found = about | {"deviation": deviation, "temporal_snr": ratio}
        if model is not None:
            times = [row["time"] for row in part]
            if any(time is None for time in times):
                raise InvalidInput("times", "not known", "a series of a scan that stores the times of its shots")
            found |= asdict(fit_time_course(times, means, model))
        made.append(found)
    return made
