"""Motion of the object during a scan: estimation from the A-lines themselves, and motion-compensated reconstruction.

An object that is shifted by s(T) at the time T of a shot sounds as if the sensor were shifted by −s(T). The image of
all A-lines is thresholded and propagated to the sensors; what each A-line deviates from that prediction, projected onto
the derivatives along x, y and z, gives a Gauss–Newton step for s at knots in time, with a weak penalty on its second
difference. A few rounds of reconstruction and step suffice. The mean shift is 0: the image is of the mean place.

Shifts along the film are shifts of the sensors. Shifts in depth are interpolated between a few planes
(cubic Lagrange weights): each A-line's share of a plane is imaged and that image moved by the plane's shift, which is
exact for a rigid shift, as the direct formula is linear.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging.acquisition import Acquisition
from steradian.imaging.motion_model import MovingObject
from steradian.imaging.options import Compute, DirectMethod, ImageGrid, Nufft
from steradian.imaging.volume import Volume

__all__ = ["Motion", "estimate_motion", "reconstruct_moving"]

Floats = NDArray[np.float64]
LINES_PER_KNOT = 20
"""A-lines between two knots, unless an interval is given."""
MOST_KNOTS = 2000
SMOOTHNESS, RIDGE = 1e-3, 1e-6
"""Weights of the squared second difference and of the squared shift, relative to the mean curvature."""
LONGEST_STEP = 60e-6
"""Longest change of a shift in one round, in m."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Shift of the object over the time of a scan, about its mean.

    Parameters
    ----------
    times
        Knots in s, rising, shape (K,); the shift is linear between them.
    shifts
        Along x, y and z in m, shape (K, 3); positive: towards larger coordinates, deeper.
    standard_errors
        Of the shifts, shape (K, 3): half the difference of what two halves of the A-lines give, as root mean square.
    """

    times: Floats
    shifts: Floats
    standard_errors: Floats

    def at(self, times: ArrayLike) -> Floats:
        """Return the shifts at times in s, shape (M, 3)."""
        wanted = np.asarray(times, np.float64)
        return np.stack([np.interp(wanted, self.times, column) for column in self.shifts.T], axis=1)

    @property
    def is_significant(self) -> bool:
        """Whether the shifts exceed twice their standard errors along an axis, by root mean square."""
        found, error = (np.sqrt(np.mean(np.square(each), axis=0)) for each in (self.shifts, self.standard_errors))
        return bool((found > 2 * error).any())


def estimate_motion(
    acquisition: Acquisition,
    times: ArrayLike,
    grid: ImageGrid,
    *,
    interval: float | None = None,
    reach: float = 200e-6,
    rounds: int = 4,
    compute: Compute = Compute(),
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Motion:
    """Estimate the motion of the object during a scan.

    Parameters
    ----------
    acquisition
        A-lines (M, N_t) of sensors on a plane in one medium, in an order that does not follow the places: each tenth of
        the scan must see the object from all sides, as the progressive order does.
    times
        Of the shots in s, shape (M,).
    grid
        Voxels of the images compared, without upsampling; coarse ones do, with ``depth`` about the object.
    interval
        Time between two knots in s; None: that of 20 A-lines.
    reach
        Greatest depth shift in m, 20 µm to 1 mm.
    rounds
        Gauss–Newton steps.
    compute, progress, cancelled
        As of :func:`steradian.reconstruct`.

    Raises
    ------
    InvalidInput
        If a parameter is out of range, the sensors are on a line, or the medium has several layers.
    Cancelled
        If ``cancelled`` returned true.
    """
    problem = MovingObject.of(acquisition, times, grid, reach, compute)
    span = float(np.ptp(problem.times))
    wanted = span * LINES_PER_KNOT / len(problem.times) if interval is None else interval
    if not 0 < wanted <= span:
        raise InvalidInput("interval", wanted, f"above 0 s, at most the scan's {span:g} s")
    knots = min(MOST_KNOTS, ceil(span / wanted) + 1)
    places = float(problem.times.min()) + span * np.linspace(0, 1, knots)
    order = np.argsort(problem.times, kind="stable")
    done = 0

    def step_done() -> None:
        nonlocal done
        if cancelled is not None and cancelled():
            raise Cancelled("cancelled during: motion")
        done += 1
        if progress is not None:
            progress("motion", done, 3 * rounds)

    whole = _fitted(problem, places, rounds, reach, step_done)
    halves = [_fitted(problem.part(order[n::2]), places, rounds, reach, step_done) for n in (0, 1)]
    error = np.sqrt(np.mean(np.square(halves[0] - halves[1]), axis=0)) / 2
    return Motion(places, whole, np.broadcast_to(error, whole.shape))


def _fitted(problem: MovingObject, places: Floats, rounds: int, reach: float, step_done: Callable[[], None]) -> Floats:
    """Return the shifts (K, 3) at the knots by Gauss–Newton steps."""
    knots = len(places)
    base = _hats(problem.times, places)
    bend = np.diff(np.eye(knots), 2, axis=0)
    shifts = np.zeros((knots, 3))
    for _ in range(rounds):
        gradient, curvature = problem.normal_equations(base @ shifts)
        data = np.einsum("mk,mij,ml->kilj", base, curvature, base, optimize=True).reshape(3 * knots, 3 * knots)
        prior = np.kron(SMOOTHNESS * bend.T @ bend + RIDGE * np.eye(knots), np.eye(3))
        prior *= float(np.trace(data)) / (3 * knots)
        right = np.einsum("mk,mi->ki", base, gradient).ravel() - prior @ shifts.ravel()
        shifts += np.clip(np.linalg.solve(data + prior, right).reshape(knots, 3), -LONGEST_STEP, LONGEST_STEP)
        shifts -= (base @ shifts).mean(axis=0)
        np.clip(shifts[:, 2], -reach, reach, out=shifts[:, 2])
        step_done()
    return shifts


def reconstruct_moving(
    acquisition: Acquisition,
    times: ArrayLike,
    motion: Motion,
    grid: ImageGrid,
    method: DirectMethod = Nufft(),
    *,
    compute: Compute = Compute(),
) -> Volume:
    """Reconstruct with the object's motion undone, by a direct method.

    Parameters
    ----------
    acquisition, times
        As of :func:`estimate_motion`.
    motion
        Shifts of the object.
    grid, method, compute
        As of :func:`steradian.reconstruct`; ``max_frequency`` of the method a number or None.

    Raises
    ------
    InvalidInput
        If a parameter is out of range.
    """
    reach = max(20e-6, float(np.abs(motion.shifts[:, 2]).max()))
    problem = MovingObject.of(acquisition, times, grid, reach, compute)
    return problem.image(motion.at(problem.times), method)


def _hats(times: Floats, places: Floats) -> Floats:
    """Return the values of linear hat functions between knots at ``places`` at the times, shape (M, K)."""
    place = (times - places[0]) / (places[1] - places[0])
    low = np.clip(np.floor(place).astype(np.int64), 0, len(places) - 2)
    base = np.zeros((len(times), len(places)))
    rows = np.arange(len(times))
    base[rows, low] = 1 - (place - low)
    base[rows, low + 1] = place - low
    return base
