"""Forward simulation: analytic pressure of Gaussian balls at the sensors (compiled).

A chart of fifty thousand balls seen by twenty thousand sensors takes some ten seconds this way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fabry_perot.simulator.phantoms import WINDOW, Balls, Directivity, initial_pressure
from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging.compute import thread_pool as workers
from steradian.imaging.volume import Volume

_ROWS = 32
_COSINES = 2048


def pressure(
    balls: Balls,
    positions: ArrayLike,
    *,
    samples: int,
    sampling_interval: float,
    sound_speed: float,
    time_zero: float = 0.0,
    directivity: Directivity | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> NDArray[np.float32]:
    """Return the simulated A-lines of Gaussian balls at sensors on the plane z = 0.

    Parameters
    ----------
    balls
        The object.
    positions
        (M, 2) x, y in m.
    samples
        N_t, the first one at ``time_zero`` after the laser pulse.
    sampling_interval, time_zero
        In s.
    sound_speed
        In m/s.
    directivity
        Response over the cosine of the angle of incidence, such as
        :func:`steradian.phantoms.angular_response`; ``None``: the same from everywhere.
    threads
        None: all processors this process may use, or as many as ``OMP_NUM_THREADS`` says.
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Returns
    -------
    ndarray
        (M, N_t) float32, in the unit of the amplitudes; samples further than 6 s from a ball's arrival are left out
        of it, an error below 10⁻⁷ of its peak.

    Raises
    ------
    InvalidInput
        When the positions are no points of the plane.
    Cancelled
        When ``cancelled`` said so.
    """
    where = np.ascontiguousarray(positions, dtype=np.float64)
    if where.ndim != 2 or where.shape[1] != 2:
        raise InvalidInput("positions", f"an array of shape {where.shape}", "shape (M, 2), in m")
    from steradian.phantoms.forward_kernels import add_balls

    step = sound_speed * sampling_interval
    table = np.ones(_COSINES + 1)
    if directivity is not None:
        table = np.ascontiguousarray(directivity(np.linspace(0, 1, _COSINES + 1)), dtype=np.float64)
    centres, sigmas, amplitudes = (np.ascontiguousarray(a) for a in (balls.centres, balls.sigmas, balls.amplitudes))
    traces = np.zeros((len(where), samples), np.float32)

    def work(piece: int, line: NDArray[np.float64], flag: NDArray[np.uint8]) -> None:
        rows = slice(_ROWS * piece, _ROWS * (piece + 1))
        start = sound_speed * time_zero
        add_balls(where[rows], centres, sigmas, amplitudes, start, step, WINDOW, table, line, traces[rows])

    workers.parallel_for(
        "pressure",
        -(-len(where) // _ROWS),
        lambda: np.empty(samples),
        work,
        threads=threads or workers.available_threads(),
        progress=progress,
        cancelled=cancelled,
    )
    return traces


def rasterise(balls: Balls, like: Volume) -> Volume:
    """Return the initial pressure of Gaussian balls at the voxels of a reconstruction, as its ground truth.

    Raises
    ------
    InvalidInput
        When the image is 2-D.
    """
    if like.axes.y is None:
        raise InvalidInput("like", "an image [x, z]", "a volume [x, y, z]")
    return Volume(initial_pressure(balls, like.axes.x, like.axes.y, like.axes.z), like.axes, like.spacing)
