"""Forward model and direct inversion as parametric transforms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from steradian.core.exceptions import InvalidInput
from steradian.imaging.acquisition import AcquisitionGeometry
from steradian.imaging.compute import memory_limit as memory
from steradian.imaging.engines.numba.layered import LayeredEngine
from steradian.imaging.engines.numba.memory_plan import min_bytes
from steradian.imaging.engines.selection import EngineSelector
from steradian.imaging.film_response import FilmResponse
from steradian.imaging.geometry.model import layered_geometries, model_geometry
from steradian.imaging.geometry.reconstruction import ReconstructionGeometry, resolve_geometry
from steradian.imaging.layered_tables import layered_tables
from steradian.imaging.medium import Medium
from steradian.imaging.options import Compute, ImageGrid, Nufft
from steradian.imaging.parametric.transform import REACH, STEP, Factor, ParametricTransform, Variation
from steradian.imaging.response_wrappers import TimeDerivative
from steradian.imaging.transform_tables import TransformTables, forward_tables, transposable_inverse_tables


def parametric_forward_model(
    geometry: AcquisitionGeometry,
    grid: ImageGrid,
    *,
    response: FilmResponse | None = None,
    max_frequency: float | None = None,
    tolerance: float = 1e-4,
    compute: Compute = Compute(),
    reach: float = REACH,
) -> ParametricTransform:
    """Return the forward model for unit sensitivities; in a medium of one layer, without its attenuation.

    Parameters
    ----------
    geometry, grid, response, max_frequency, tolerance, compute
        As in :class:`steradian.ForwardOperator`.
    reach
        Largest c·t of the last sample that the voxels are padded for, in those of the geometry; with 1, for variable
        positions only, the padding is that of the forward operator.

    Raises
    ------
    InvalidInput
        If a parameter is out of range.
    """
    dtype = compute.precision(tolerance)
    settings: dict[str, Any] = {"tolerance": tolerance, "window": "kaiser-bessel", "on_grid_points": False}
    if len(geometry.medium.layers) > 1:
        return _layered_model(geometry, grid, response, compute, settings | {"max_frequency": max_frequency}, reach)
    found = model_geometry(geometry, grid)
    longer, grid = _longer(geometry, reach), _with_depths(grid, found)
    base = replace(model_geometry(longer, grid), samples=geometry.samples)
    if max_frequency is not None:
        base = replace(base, highest_frequency=max_frequency)

    def make(g: ReconstructionGeometry, highest: float, factor: Factor) -> TransformTables:
        used = TimeDerivative(response) if factor == "time" else response
        return forward_tables(g, dtype, max_frequency=highest, response=used, **settings)

    variation = Variation(responding=response is not None)
    return ParametricTransform(base, partial(_selected, base, make, compute), variation, (base.sound_speed,))


def parametric_inversion(
    geometry: AcquisitionGeometry, grid: ImageGrid, method: Nufft = Nufft(), *, compute: Compute = Compute()
) -> ParametricTransform:
    """Return the transpose of the direct inversion for unit sensor weights.

    Parameters
    ----------
    geometry, grid, method, compute
        As in :class:`steradian.ReconstructionPlan`.

    Raises
    ------
    InvalidInput
        If a parameter is out of range, the medium has several layers, the method corrects a film, or the image is
        upsampled.
    """
    if len(geometry.medium.layers) > 1:
        raise InvalidInput("medium", str(geometry.medium), "one layer, for a differentiable reconstruction")
    if method.correction is not None:
        raise InvalidInput("correction", type(method.correction).__name__, "None: correct the A-lines first")
    if grid.upsampling != 1:
        raise InvalidInput("upsampling", grid.upsampling, "1 for a differentiable reconstruction")
    dtype = compute.precision(method.tolerance)
    base = resolve_geometry(geometry, grid, method.max_frequency)

    def make(g: ReconstructionGeometry, highest: float, factor: Factor) -> TransformTables:
        used = TimeDerivative(None, -1) if factor == "time" else None
        limited = replace(g, highest_frequency=highest)
        return transposable_inverse_tables(limited, dtype, tolerance=method.tolerance, response=used)

    return ParametricTransform(
        base, partial(_selected, base, make, compute), Variation(exponent=1), (base.sound_speed,)
    )


def _selected(
    base: ReconstructionGeometry, make: Callable[[ReconstructionGeometry, float, Factor], TransformTables],
    compute: Compute, sound_speeds: tuple[float, ...], time_zero: float, factor: Factor,
) -> EngineSelector:  # fmt: skip
    """Return the engine for one sound speed and time zero, with the voxels of ``base``."""

    def tables(speed: float) -> TransformTables:
        record = base.record * base.sound_speed / speed
        other = replace(base, sound_speed=speed, time_zero=time_zero, record=record)
        # the same waves, where samples resolve them; without those that are at the end of the band but for rounding
        highest = (1 - 1e-12) * base.band / (record * base.sampling_interval)
        return make(other, highest, factor)

    (sound_speed,) = sound_speeds
    found = tables(sound_speed)
    if factor in ("faster", "slower"):  # the response's table, and where waves of the same number are in it
        rule = tables(sound_speed * (1 + STEP if factor == "faster" else 1 - STEP)).rule
        found = replace(found, rule=replace(found.rule, table=rule.table, steps=rule.steps))
    memory.check_memory(min_bytes(base, found.dtype), compute.memory_limit, base.shape)
    return EngineSelector(found, compute)


def _layered_model(
    geometry: AcquisitionGeometry,
    grid: ImageGrid,
    response: FilmResponse | None,
    compute: Compute,
    settings: dict[str, Any],
    reach: float,
) -> ParametricTransform:
    """Return the model of several layers."""
    medium, dtype, dt = geometry.medium, compute.precision(settings["tolerance"]), geometry.dt
    grid = _with_depths(grid, layered_geometries(geometry, grid)[0], dt * medium.slowest)
    base, parts = layered_geometries(_longer(geometry, reach), grid)
    film = replace(base, samples=geometry.samples)
    most = settings.pop("max_frequency")
    bands = [0.5 * each.geometry.record * (1.0 if most is None else min(1.0, 2 * most * dt)) for each in parts]

    def make(speeds: tuple[float, ...], time_zero: float, factor: Factor) -> EngineSelector:
        layers = [replace(one, sound_speed=speed) for one, speed in zip(medium.layers, speeds, strict=True)]
        paths = Medium(layers).layer_paths()
        found = []
        for part, band in zip(parts, bands, strict=True):
            path, g = paths[len(part.path.overlying)], part.geometry
            record = g.record * g.sound_speed / path.sound_speed
            highest = (1 - 1e-12) * band / (record * dt)  # the same waves, as in one layer
            g = replace(g, sound_speed=path.sound_speed, record=record, highest_frequency=highest)
            # fields of the layers below are heard from the pulse on, and for as long as the latest record
            if not path.overlying:
                g = replace(g, samples=geometry.samples, time_zero=time_zero)
            found.append(replace(part, path=path, geometry=g))
        tables, of_layers = layered_tables(
            replace(film, time_zero=time_zero), found, dtype, response=response, max_frequency=None, **settings
        )
        memory.check_memory(min_bytes(film, dtype), compute.memory_limit, film.shape)
        return EngineSelector(tables, compute, partial(LayeredEngine, layers=of_layers))

    speeds = tuple(layer.sound_speed for layer in medium.layers)
    return ParametricTransform(film, make, Variation(quotient=True), speeds)


def _with_depths(grid: ImageGrid, found: ReconstructionGeometry, step: float | None = None) -> ImageGrid:
    """Return the grid with the depths of a geometry, ``step`` apart, which do not follow a longer record."""
    step = step or found.depth_step
    return grid if grid.depth else replace(grid, depth=(found.depth[0] * step, (found.depth[1] - 0.6) * step))


def _longer(geometry: AcquisitionGeometry, reach: float) -> AcquisitionGeometry:
    """Return the geometry with the samples of a record that reaches deeper by a factor."""
    late = max(0.0, geometry.t0 / geometry.dt)
    return replace(geometry, samples=int(np.ceil(reach * (geometry.samples + late) - late - 1e-9)))
