"""Engine-independent tables of the transforms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging import validation as checks
from steradian.imaging.film_response import FilmResponse, tabulate
from steradian.imaging.geometry.reconstruction import ReconstructionGeometry
from steradian.imaging.options import DirectMethod, Precision
from steradian.imaging.response_wrappers import ConjugatedResponse, ResponseThroughLayers
from steradian.imaging.sensing_spot import changes_sign
from steradian.imaging.transforms.decimation import Decimation, plan_decimation
from steradian.imaging.transforms.grid_sizes import lateral_grid
from steradian.imaging.transforms.lateral import LateralTransform, detect_grid, linearly_gridded, non_uniform, on_grid
from steradian.imaging.transforms.time_to_depth import (
    KappaMap,
    TimeInterpolation,
    nearest_or_linear,
    window_interpolation,
)
from steradian.imaging.transforms.windows import Shape, Window


@dataclass(frozen=True, slots=True, eq=False)
class TransformTables:
    """Precomputed tables of a geometry, used by engines (:mod:`steradian.imaging.engines`).

    Parameters
    ----------
    geometry
        Sensors, image and times.
    method
        Name of the method used: "ner" instead of "nedner" if the sensors are on a grid.
    dtype
        Working precision.
    lateral
        Sensors to lateral modes.
    time
        Transform over time, of A-lines after the decimation.
    rule
        From which κ which depth frequency comes, and how.
    decimation
        What is done to A-lines first, if anything.
    transposable
        Whether engines are to compute the transpose, too. Lateral modes at the Nyquist frequency of an even N are then
        left out, as there is one number for both of its signs.
    """

    geometry: ReconstructionGeometry
    method: str
    dtype: Precision
    lateral: LateralTransform
    time: TimeInterpolation
    rule: KappaMap
    decimation: Decimation | None = None
    transposable: bool = False

    @property
    def depths(self) -> int:
        """Number of depth slices of the image."""
        return self.geometry.shape[-1]

    @property
    def spectrum_length(self) -> float:
        """Divisor of sums over the spectrum: N_t in the inversion, N_z in the forward model and its adjoint."""
        return self.geometry.record if self.rule.waves == "rising" else self.geometry.depth_points

    @property
    def image_modes(self) -> tuple[int, int]:
        """Size of the image FFT, which is the padded image with its upsampling; (1, N) in 2-D."""
        up, (nx, ny) = self.geometry.upsampling, self.lateral.modes
        return nx * (up if nx > 1 else 1), ny * up

    @property
    def visible_region(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """First point and number of points along x and y of the image within the padded one; (0, 1) in 2-D."""
        g = self.geometry
        skipped = [(p // 2 - n // 2) * g.upsampling for p, n in zip(g.padded_modes, g.modes, strict=True)]
        pairs = list(zip(skipped, g.shape[:-1], strict=True))
        return (pairs[0], pairs[1]) if len(pairs) == 2 else ((0, 1), pairs[0])


def transposable_inverse_tables(
    geometry: ReconstructionGeometry, dtype: Precision, *, tolerance: float, response: FilmResponse | None
) -> TransformTables:
    """Return tables of the inversion, of which engines compute the transpose, too, with unit sensor weights.

    Sensors are taken to be on no grid, and A-lines are not decimated. The lateral modes at the Nyquist frequency of an
    even N are left out.

    Parameters
    ----------
    geometry, dtype
        As in :func:`inverse_tables`.
    tolerance
        Relative error against the direct sums.
    response
        Factor of each wave.
    """
    modes, places, share = _modes(geometry), _places(geometry), _share(geometry, tolerance)
    point = float(np.prod([X / n for X, n in zip(geometry.period, geometry.padded_modes, strict=True)]))
    sizes, window = lateral_grid(modes, len(places), "kaiser-bessel", share)
    lateral = non_uniform(places, np.full(len(places), 1 / point), modes, window, sizes)
    time = window_interpolation(geometry.samples, float(geometry.record), "kaiser-bessel", share, 0.05 * tolerance)
    rule = _kappa_map(geometry, time, geometry.band, "rising", response)
    return TransformTables(geometry, "nedner", dtype, lateral, time, rule, transposable=True)


def inverse_tables(geometry: ReconstructionGeometry, options: DirectMethod, dtype: Precision) -> TransformTables:
    """Return the tables of the inversion (paper, equation 7).

    Parameters
    ----------
    geometry
        Sensors, image and times.
    options
        Direct method.
    dtype
        Working precision.

    Raises
    ------
    InvalidInput
        If the method is "ner" and the sensors are on no grid.
    """
    method, tolerance, window = options.name, options.tolerance, options.window
    modes, places, share = _modes(geometry), _places(geometry), _share(geometry, tolerance)
    point = float(np.prod([X / n for X, n in zip(geometry.period, geometry.padded_modes, strict=True)]))
    grid = detect_grid(places, modes, 0.1 * tolerance, _rounding(geometry))
    if method == "ner" and grid is None:
        raise InvalidInput("method", method, "nedner: the sensors are not on a grid that divides the aperture")
    if method == "interpolated":
        grid = grid or [(n, 0.0) for n in modes]
        cell = float(np.prod(geometry.period)) / (grid[0][0] * grid[1][0])
        lateral = linearly_gridded(places, cell / point, modes, grid)
    elif grid is not None:
        lateral = on_grid(places, geometry.weights / point, modes, grid)
    else:
        sizes, found = lateral_grid(modes, len(places), window, share)
        lateral = non_uniform(places, geometry.weights / point, modes, found, sizes)
    if method in ("linear", "nearest"):
        fewer = None  # these interpolate between the frequencies of the record as it is
        time = nearest_or_linear(geometry.samples, int(geometry.record), method == "nearest")
    else:
        fewer = plan_decimation(geometry.samples, geometry.band / geometry.record, 0.2 * tolerance)
        samples, record = geometry.samples, float(geometry.record)
        if fewer is not None:
            samples, record = fewer.samples, geometry.record / fewer.every
        time = window_interpolation(samples, record, window, share, 0.05 * tolerance)
    used = "ner" if method == "nedner" and grid is not None else method
    rule = _kappa_map(geometry, time, geometry.band, "rising", options.correction, fewer)
    return TransformTables(geometry, used, dtype, lateral, time, rule, fewer)


def forward_tables(
    geometry: ReconstructionGeometry,
    dtype: Precision,
    *,
    tolerance: float,
    window: Shape | Window,
    max_frequency: float | None,
    response: FilmResponse | None,
    on_grid_points: bool = True,
) -> TransformTables:
    """Return the tables of the forward model and its adjoint (:mod:`steradian.imaging.operators`).

    Sensors' weights play no part, and the lateral spectrum is never one that repeats. Without ``on_grid_points`` no
    sensor is taken to be on a grid, so that they can be moved. Other parameters as in
    :class:`steradian.ForwardOperator`.
    """
    modes, places, share = _modes(geometry), _places(geometry), _share(geometry, tolerance)
    grid, ones = None, np.ones(len(places))
    if on_grid_points:
        grid = detect_grid(places, modes, 0.1 * tolerance, _rounding(geometry))
    if grid is not None and all(n % g == 0 and s == 0 for n, (g, s) in zip(modes, grid, strict=True)):
        lateral = on_grid(places, ones, modes, [(n, 0.0) for n in modes])
    else:
        sizes, found = lateral_grid(modes, len(places), window, share)
        lateral = non_uniform(places, ones, modes, found, sizes)
    time = window_interpolation(geometry.samples, geometry.record, window, share, 0.05 * tolerance)
    band = 0.5 * geometry.record
    if max_frequency is not None:
        band = min(band, max_frequency * geometry.sampling_interval * geometry.record)
    rule = _kappa_map(geometry, time, band, "both", None if response is None else ConjugatedResponse(response))
    return TransformTables(geometry, "nedner", dtype, lateral, time, rule, transposable=True)


def moved(tables: TransformTables, positions: NDArray[np.float64], derivative: int | None = None) -> LateralTransform:
    """Return the lateral transform of tables with the sensors at other positions (M, d−1) in m.

    With ``derivative`` (0 or 1, the lateral axis) its derivative by each sensor's position along that axis, per metre.

    Raises
    ------
    ValueError
        If the tables' sensors are on a grid.
    """
    lateral, window = tables.lateral, tables.lateral.windows[1]
    if window is None:
        raise ValueError("sensors on a grid cannot be moved")
    geometry = replace(tables.geometry, positions=positions)
    scale, axis = lateral.scale, None
    if derivative is not None:
        scale = scale / geometry.period[derivative]
        axis = derivative if positions.shape[1] == 2 else 1
    return non_uniform(_places(geometry), scale, lateral.modes, window, lateral.grid, axis)


def _kappa_map(
    g: ReconstructionGeometry,
    time: TimeInterpolation,
    band: float,
    waves: Literal["rising", "both"],
    response: FilmResponse | None,
    fewer: Decimation | None = None,
) -> KappaMap:
    path, overlying, shift = g.path, np.empty((0, 2)), 0.0
    if path is not None:
        length = g.record * g.sampling_interval  # seconds of a record
        thickness = np.array([layer.thickness for layer in path.overlying], np.float64)
        speeds = np.array([layer.sound_speed for layer in path.overlying])
        overlying = (np.stack([thickness / speeds, thickness / g.sound_speed], axis=1) / length) ** 2
        shift = path.top / (length * g.sound_speed)
        if response is not None or path.layers[0].density is not None:
            response = ResponseThroughLayers(path, response, inverse=waves == "rising")
    table, steps = tabulate(
        response, nyquist=0.5 / g.sampling_interval, bandwidth=0.5 * g.record, sound_speed=g.sound_speed,
        signed=changes_sign(response),
    )  # fmt: skip
    scales = [g.record * g.sound_speed * g.sampling_interval / X for X in g.period]
    first = g.time_zero / g.sampling_interval + (0.0 if fewer is None else fewer.first)
    turns = time.centre / time.record + first / g.record
    return KappaMap(
        (0.0, scales[0]) if len(scales) == 1 else (scales[0], scales[1]),
        turns,
        band,
        waves,
        table,
        steps,
        overlying,
        shift,
    )


def _modes(g: ReconstructionGeometry) -> tuple[int, int]:
    n: Sequence[int] = g.padded_modes
    return (1, n[0]) if len(n) == 1 else (n[0], n[1])


def _places(g: ReconstructionGeometry) -> NDArray[np.float64]:
    """Return sensor positions (M, 2) in periods; 0 along the missing axis in 2-D."""
    places = g.normalised_positions()
    return places if places.shape[1] == 2 else np.concatenate([np.zeros_like(places), places], axis=1)


def _rounding(g: ReconstructionGeometry) -> float:
    """Return the rounding error of float32 positions in periods, as tolerance of grid detection; 0 for float64."""
    if not np.array_equal(g.positions, g.positions.astype(np.float32)):
        return 0.0
    return checks.ROUNDING * float(np.max(np.abs(g.positions) / np.array(g.period)))


def _share(g: ReconstructionGeometry, tolerance: float) -> float:
    """Return the error permitted for each of the lateral axes and time."""
    return 0.4 * tolerance / sqrt(len(g.modes) + 1)
