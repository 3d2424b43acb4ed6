"""Argument tuples of the CUDA kernels."""

from __future__ import annotations

from typing import Any, NamedTuple


class Sparse(NamedTuple):
    """Sparse matrix in CSR form: row r has ``weights[e]`` in column ``columns[e]``, starts[r] ≤ e < starts[r + 1]."""

    starts: Any
    columns: Any
    weights: Any


class ModeOrbits(NamedTuple):
    """Lateral modes (±jx, ±jy), which share κ; orbit a·len(squares_y) + b has line a along x and b along y.

    Parameters
    ----------
    lines_x, lines_y
        (A, 4) and (B, 4): where jx and −jx (jy and −jy) are among modes over frequencies, and among modes over depth.
    factors_x, factors_y
        (A, 2) and (B, 2) complex: lateral factors of jx and −jx (jy and −jy).
    squares_x, squares_y
        (A,) and (B,): their parts of κ².
    """

    lines_x: Any
    lines_y: Any
    factors_x: Any
    factors_y: Any
    squares_x: Any
    squares_y: Any


class KappaMap(NamedTuple):
    """Parameters of the interpolation at κ, and of its phase factor (:mod:`.transforms.time_to_depth`).

    Parameters
    ----------
    taps
        (w, D + 1) polynomials.
    table, steps
        The response.
    overlying, shift
        Phase of the layers above.
    ratio
        Frequencies a unit of κ.
    turns, band
        As in :class:`~steradian.imaging.transforms.time_to_depth.KappaMap`.
    lowest
        Number of the first frequency.
    depths
        Depth frequencies l that there can be, from 0.
    both, nearest
        Waves go both ways; no stencil.
    """

    taps: Any
    table: Any
    steps: Any
    overlying: Any
    shift: float
    ratio: float
    turns: float
    band: float
    lowest: int
    depths: int
    both: bool
    nearest: bool


class DecimationArgs(NamedTuple):
    """Resampling of A-lines to fewer samples (:class:`steradian.imaging.transforms.decimation.Decimation`)."""

    starts: Any
    taps: Any
