"""Argument tuples of the compiled kernels."""

from __future__ import annotations

from typing import Any, NamedTuple


class Batch(NamedTuple):
    """Batch of ``number`` ≤ 32 samples (or depths) from ``start``, of rows with a stride of ``stride`` numbers.

    Results are written ``past`` the caches, where they are too many for these.
    """

    start: int
    number: int
    stride: int
    non_temporal: bool


class Factors(NamedTuple):
    """FFT tables of ``size`` cells as kernel arguments."""

    size: int
    radices: Any
    twiddles: Any
    twiddle_starts: Any
    generic: Any
    generic_starts: Any


class Sensors(NamedTuple):
    """Sensors as arguments of the spreading kernels: traces to the grid [line x][cell y].

    If ``separable``, packed trace m adds to cells first[m] … of the lines following its bin, bins being given by
    ``starts``, with taps wx[m]·wy[m] (an even number of these). Else entry e of a line adds wy[e, 0] times trace
    sensors[e] to cell first[e]. Packed trace m is trace order[m] times scale[m].
    """

    separable: bool
    order: Any
    scale: Any
    starts: Any
    first: Any
    sensors: Any
    wx: Any
    wy: Any


class StoredModes(NamedTuple):
    """Stored modes of a lateral grid: mode (i, k) is column c = k·len(xs) + i, rows 2c (real) and 2c + 1.

    ``xs``, ``ys``: index in the grid of each mode along x (all) and y (the half that is not negative);
    ``xs_opposite``, ``ys_opposite`` of the mode of the opposite sign. Of even numbers of modes the one at N/2 is read
    at −N/2, and for negative κ at +N/2 as well, which differs unless sensors are on the grid: ``edge_rows[i, k]`` is
    the row of the latter, or −1, and it is read at ``edge_xs``, with y turned round where ``edge_swap[k]``.
    """

    xs: Any
    ys: Any
    xs_opposite: Any
    ys_opposite: Any
    edge_xs: Any
    edge_xs_opposite: Any
    edge_rows: Any
    edge_swap: Any


class ImagePlane(NamedTuple):
    """FFTs along x and y, and the image's points: ``shown`` rows from ``first``, along x and y."""

    modes_x: int
    modes_y: int
    x: Factors
    y: Factors
    first_x: int = 0
    shown_x: int = 0
    first_y: int = 0
    shown_y: int = 0


class Workspace(NamedTuple):
    """Scratch lines of a thread for the lateral FFTs."""

    packed: Any
    a: Any
    b: Any
    c: Any
    d: Any
    middle: Any
    tmp: Any


class AxisTransform(NamedTuple):
    """FFT over time or depth of all modes: ``number`` numbers n of a row map to cell n − ``centre``.

    Lane i of block b is at ``real[b, i]`` and ``imaginary[b, i]`` of ``values``. ``window`` (number,) multiplies the
    numbers, and ``factors[b]`` the modes: a + ib becomes (f0·a + f1·b) + i(f2·a + f3·b), 16 lanes each. Where both are
    empty, nothing is multiplied.
    """

    values: Any
    real: Any
    imaginary: Any
    number: int
    centre: int
    window: Any
    factors: Any
    transform: Factors


class KappaMap(NamedTuple):
    """Interpolation of depth frequencies at κ (:class:`steradian.imaging.transforms.time_to_depth.KappaMap`).

    ``squares`` (B, groups) is |j|² of each group of lanes; ``edges`` tells of pairs of lanes of which the even one is
    read at −N/2 for κ > 0 and the odd one at +N/2 for κ < 0. ``sine`` and ``cosine`` are their power series.
    """

    squares: Any
    edges: Any
    ratio: float
    turns: float
    band: float
    both: bool
    nearest: bool
    polynomials: Any
    table: Any
    steps: Any
    overlying: Any
    shift: float
    sine: Any
    cosine: Any


class DepthWorkspace(NamedTuple):
    """Scratch arrays of a thread for the time-to-depth transform: two FFTs, and stencils of PIECE values of l."""

    a: Any
    b: Any
    index: Any
    fraction: Any
    phase: Any
    gain: Any
    taps: Any
    tmp: Any
