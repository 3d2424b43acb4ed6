"""Lateral transform between sensors and grid: NUFFT of type 1 (sensors to modes), and of type 2 as its adjoint.

Mode j of sensors at x_m with values v_m is Σ_m v_m·e^{−2πi j·x_m/X}. Each sensor is spread onto the points of a grid
near it, the grid is transformed, and what the window did to mode j is divided out (paper, NED-NUFFT, equation 6).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.transforms.linear_gridding import linear_gridding_weights
from steradian.imaging.transforms.windows import Window

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Stencils:
    """Spreading stencils: sensor m has ``tx[m, t]``·``ty[m, u]`` at point (``first[m, 0]`` + t, ``first[m, 1]`` + u).

    Shapes (M, 2), (M, w) and (M, w), or (M, 1) along an axis that 2-D does not have; points count modulo the grid.
    """

    first: Ints
    tx: Floats
    ty: Floats


@dataclass(frozen=True, slots=True, eq=False)
class GridEntries:
    """Sparse entries (line, cell, sensor, weight) of sensors on grid points.

    Point (``lines[e]``, ``cells[e]``) takes ``weights[e]`` of sensor ``sensors[e]``.
    """

    lines: Ints
    cells: Ints
    sensors: Ints
    weights: Floats


@dataclass(frozen=True, slots=True, eq=False)
class LateralTransform:
    """Tables of the lateral transform: grid size, sensors and modes.

    Parameters
    ----------
    grid
        Points (nx, ny) of a period; nx = 1 in 2-D.
    modes
        (Nx, Ny) of the formula; more than the grid's where its spectrum repeats.
    sensors
        How they are spread onto the grid.
    scale
        (M,) factor of each sensor: h_m over the area of an image point.
    shift
        Distance of the sensors from the grid's points, in cells (NER with the grid displaced).
    windows
        Along x and y, None where sensors are on the grid.
    """

    grid: tuple[int, int]
    modes: tuple[int, int]
    sensors: Stencils | GridEntries
    scale: Floats
    shift: tuple[float, float] = (0.0, 0.0)
    windows: tuple[Window | None, Window | None] = (None, None)

    @property
    def replicated(self) -> bool:
        """Whether the grid is coarser than the modes, so that its spectrum repeats."""
        return self.grid[0] < self.modes[0] or self.grid[1] < self.modes[1]

    def factor(self, axis: int, numbers: Ints) -> NDArray[Any]:
        """Return the correction factor of mode j: shift e^{−2πi j·shift/n}, divided by the window's transform."""
        n, shift, window = self.grid[axis], self.shift[axis], self.windows[axis]
        found = np.exp(-2j * np.pi / n * shift * numbers) if shift else np.ones(numbers.shape)
        if window is None:
            return found
        least = int(numbers.min())  # a few thousand different numbers stand for millions of modes
        return found / window.transform(np.arange(least, int(numbers.max()) + 1) / n)[numbers - least]


def numbers_of(count: int) -> Ints:
    """Return the mode numbers in FFT order, Nyquist as −N/2."""
    n = np.arange(count)
    return np.where(2 * n < count, n, n - count)


def detect_grid(
    places: Floats, modes: tuple[int, ...], accuracy: float, rounding: float = 0.0
) -> list[tuple[int, float]] | None:
    """Return for each axis the grid (points a period, shift in cells) of all sensors, or None.

    They may be beside its points by ``accuracy`` cells, or ``rounding`` periods if that is more.

    Grids finer than twice the modes, where a plain transform would cost more than it saves, do not count.
    """
    found: list[tuple[int, float]] = []
    for axis in range(places.shape[1]):
        u = np.unique(np.round(places[:, axis], 12))
        gaps = np.diff(np.append(u, u[0] + 1.0))
        gaps = gaps[gaps > 1e-3 / modes[axis]]
        step = float(gaps.min()) if gaps.size else 1.0
        best = None
        for count in dict.fromkeys((round(1.0 / step), modes[axis])):  # the coarser is cheaper
            if not 1 <= count <= 2 * modes[axis]:
                continue
            angle = np.angle(np.mean(np.exp(2j * np.pi * u * count))) / (2 * np.pi)
            off = u * count - angle
            beside = max(accuracy, rounding * count)
            if np.abs(off - np.round(off)).max() <= beside:
                best = (count, 0.0 if abs(angle) <= beside else float(angle))
                break
        if best is None:
            return None
        found.append(best)
    return found


def on_grid(places: Floats, scale: Floats, modes: tuple[int, int], grid: list[tuple[int, float]]) -> LateralTransform:
    """Return the lateral transform of sensors on grid points (NER); several on one point add up."""
    counts, shift = (grid[0][0], grid[1][0]), (grid[0][1], grid[1][1])
    lines, cells = (np.rint(places[:, a] * counts[a] - shift[a]).astype(np.int64) % counts[a] for a in (0, 1))
    entries = GridEntries(lines, cells, np.arange(len(places)), np.ones(len(places)))
    return LateralTransform(counts, modes, entries, scale, shift)


def linearly_gridded(
    places: Floats, cell_scale: float, modes: tuple[int, int], grid: list[tuple[int, float]]
) -> LateralTransform:
    """Return the lateral transform by linear interpolation to a grid; ``cell_scale``: weight of a grid point."""
    counts, shift = (grid[0][0], grid[1][0]), (grid[0][1], grid[1][1])
    return LateralTransform(
        counts,
        modes,
        GridEntries(*linear_gridding_weights(places, counts, shift)),
        np.full(len(places), cell_scale),
        shift,
    )


def non_uniform(
    places: Floats,
    scale: Floats,
    modes: tuple[int, int],
    window: Window,
    grid: tuple[int, int],
    derivative: int | None = None,
) -> LateralTransform:
    """Return the NUFFT for arbitrary positions ``places`` (M, 2) in periods (NED); ``grid[0]`` is 1 in 2-D.

    With ``derivative`` 0 or 1 its derivative by each sensor's own position along that axis, in periods.
    """
    windows = (None if grid[0] == 1 else window, window)
    first, taps = np.zeros((len(places), 2), np.int64), []
    for axis, shape in enumerate(windows):
        if shape is None:
            taps.append(np.ones((len(places), 1)))
            continue
        left = places[:, axis] * grid[axis] - shape.width / 2
        whole = np.floor(left)
        first[:, axis] = (whole.astype(np.int64) + 1) % grid[axis]
        slopes = axis == derivative
        taps.append(grid[axis] * shape.tap_slopes(left - whole) if slopes else shape.taps(left - whole))
    return LateralTransform(grid, modes, Stencils(first, *taps), scale, windows=windows)
