"""Conversion of the transform tables to the layout of the CUDA kernels."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.engines.cuda.kernel_args import KappaMap, ModeOrbits, Sparse
from steradian.imaging.transform_tables import TransformTables
from steradian.imaging.transforms.lateral import LateralTransform, Stencils, numbers_of

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Frequencies:
    """Range of time frequencies from which depths are interpolated: ``count`` of them from number ``lowest``.

    Number f is f cells of a transform of ``length``; a spectrum of real samples has those of 0 to length/2, the others
    are conjugates.
    """

    lowest: int
    count: int
    length: int

    @property
    def half_spectrum_indices(self) -> Ints:
        """Indices of the frequencies in the stored half spectrum of real samples."""
        cells = self.full_spectrum_indices
        return np.where(cells <= self.length // 2, cells, self.length - cells)

    @property
    def full_spectrum_indices(self) -> Ints:
        """Indices of the frequencies in the full spectrum."""
        return np.arange(self.lowest, self.lowest + self.count) % self.length

    @property
    def conjugated(self) -> tuple[int, int]:
        """Numbers of leading and of trailing frequencies that are conjugates of stored ones."""
        return -self.lowest, max(0, self.lowest + self.count - 1 - self.length // 2)


def frequencies(tables: TransformTables) -> Frequencies:
    """Return the range of frequencies that the interpolation stencils use."""
    time, width = tables.time, len(tables.time.taps)
    highest = tables.rule.band * time.length / time.record
    if time.nearest:
        return Frequencies(0, floor(highest + 0.5) + 1, time.length)
    lowest = floor(-0.5 * width) + 1
    return Frequencies(lowest, floor(highest - 0.5 * width) + 1 + width - lowest, time.length)


def matrix(lateral: LateralTransform) -> Any:
    """Return the SciPy sparse matrix from sensors to points of the flat grid, without the sensors' scale."""
    from scipy.sparse import csr_array

    s, (nx, ny) = lateral.sensors, lateral.grid
    if isinstance(s, Stencils):
        x = (s.first[:, 0, None] + np.arange(s.tx.shape[1])) % nx
        y = (s.first[:, 1, None] + np.arange(s.ty.shape[1])) % ny
        points = (x[:, :, None] * ny + y[:, None, :]).reshape(len(x), -1)
        weights = (s.tx[:, :, None] * s.ty[:, None, :]).reshape(len(x), -1)
        sensors = np.repeat(np.arange(len(x)), points.shape[1])
        return csr_array((weights.ravel(), (points.ravel(), sensors)), shape=(nx * ny, len(lateral.scale)))
    return csr_array((s.weights, (s.lines * ny + s.cells, s.sensors)), shape=(nx * ny, len(lateral.scale)))


def sparse(found: Any, dtype: str) -> Sparse:
    """Convert a SciPy sparse matrix to the kernels' CSR arrays."""
    found = found.tocsr()
    return Sparse(found.indptr.astype(np.int64), found.indices.astype(np.int32), found.data.astype(dtype))


@dataclass(frozen=True, slots=True)
class Axis:
    """Modes along one lateral axis, as pairs (orbits) of j and −j.

    Parameters
    ----------
    modes
        Indices (A, 2) of j and −j among the N modes.
    lines
        Lines of the grid of all modes (N,).
    used
        Lines of the grid that modes are on, ascending where they are on all, else in the modes' order.
    factors
        Complex (A, 2).
    squares
        Part of κ² (A,).
    """

    modes: Ints
    lines: Ints
    used: Ints
    factors: NDArray[Any]
    squares: NDArray[np.float64]


def axis_of(tables: TransformTables, axis: int) -> Axis:
    """Return the orbits along one axis; the factors along x include the norm of the transforms."""
    lateral, count = tables.lateral, tables.lateral.modes[axis]
    numbers = numbers_of(count)
    factors = np.asarray(lateral.factor(axis, numbers), np.complex128)
    if tables.transposable:  # N/2, which is −N/2 as well, is left out
        factors = np.where((2 * numbers == -count) & (count > 1), 0, factors)
    if axis == 0:
        factors = factors / (lateral.modes[0] * lateral.modes[1] * tables.spectrum_length)
    orbits = np.arange(count // 2 + 1)
    modes = np.stack([orbits, -orbits % count], axis=1)
    lines = numbers % lateral.grid[axis]
    used = lines if count <= lateral.grid[axis] else np.arange(lateral.grid[axis])
    kind = np.complex64 if tables.dtype == "float32" else np.complex128
    squares = np.asarray((tables.rule.scales[axis] * numbers[orbits]) ** 2, np.float64)
    return Axis(modes, lines, used, np.ascontiguousarray(factors[modes].astype(kind)), squares)


def all_orbits(x: Axis, y: Axis) -> ModeOrbits:
    """Return the orbits of all lateral modes, for a run in one pass."""
    lines_x, lines_y = (np.concatenate([axis.lines[axis.modes], axis.modes], axis=1) for axis in (x, y))
    return ModeOrbits(lines_x, lines_y, x.factors, y.factors, x.squares, y.squares)


def orbit_slice(x: Axis, y: Axis, first: int, last: int) -> tuple[ModeOrbits, Ints, Ints]:
    """Return orbits ``first`` … ``last`` along x, for arrays that contain only the lines of their j and −j.

    Returns
    -------
    tuple
        The orbits, and the lines of which those arrays are made: of the used ones of the grid, and of the modes.
    """
    modes = x.modes[first:last]
    local = np.arange(2 * (last - first)).reshape(-1, 2)
    place = np.full(int(max(y.used)) + 1, -1)
    place[y.used] = np.arange(len(y.used))
    lines_y = np.concatenate([place[y.lines[y.modes]], y.modes], axis=1)
    lines_x = np.concatenate([local, local], axis=1)
    found = ModeOrbits(lines_x, lines_y, x.factors[first:last], y.factors, x.squares[first:last], y.squares)
    rows = np.full(int(max(x.used)) + 1, -1)
    rows[x.used] = np.arange(len(x.used))
    return found, rows[x.lines[modes]].ravel(), modes.ravel()


def kappa_map(tables: TransformTables, found: Frequencies) -> KappaMap:
    """Return the kernels' parameters of the interpolation at κ."""
    rule, time, points = tables.rule, tables.time, tables.geometry.depth_points
    return KappaMap(
        time.taps.astype(tables.dtype), rule.table, rule.steps, rule.overlying, rule.shift,
        time.length / time.record, rule.turns, rule.band,
        found.lowest, (points + 1) // 2, rule.waves == "both", time.nearest,
    )  # fmt: skip
