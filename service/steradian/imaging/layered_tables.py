"""Tables of the forward model of a layered medium: those of each layer, and the way from there to the film."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.film_response import FilmResponse
from steradian.imaging.geometry.model import LayerGeometry
from steradian.imaging.geometry.reconstruction import ReconstructionGeometry
from steradian.imaging.medium import LayerPath, Medium
from steradian.imaging.options import Precision
from steradian.imaging.signal.attenuation import attenuation_matrix
from steradian.imaging.transform_tables import TransformTables, forward_tables
from steradian.imaging.transforms.extrapolation import Extrapolation, plan_extrapolation
from steradian.imaging.transforms.windows import Shape, Window


@dataclass(frozen=True, slots=True, eq=False)
class LayerTables:
    """Tables of one layer of the forward model.

    Parameters
    ----------
    tables
        Of the field at the plane of the layer's first slice; at the film for the layer at the film.
    slices
        First slice of the layer in the volume, and one past its last.
    extrapolation
        From that plane to the film; None for the layer at the film.
    attenuation
        (N, N) matrix over the N times of the plane's field, of the layer's own attenuation; None if it is lossless.
    """

    tables: TransformTables
    slices: tuple[int, int]
    extrapolation: Extrapolation | None
    attenuation: NDArray[np.float64] | None


def layered_tables(
    film: ReconstructionGeometry,
    layers: Sequence[LayerGeometry],
    dtype: Precision,
    *,
    tolerance: float,
    window: Shape | Window,
    max_frequency: float | None,
    response: FilmResponse | None,
    on_grid_points: bool = True,
) -> tuple[TransformTables, list[LayerTables]]:
    """Return the tables of sensors and record with the whole volume, and those of each layer in its depth range.

    Parameters
    ----------
    film, layers
        Of :func:`.model.layered_geometries`.
    dtype, tolerance, window, max_frequency, response
        As in :class:`steradian.ForwardOperator`.
    on_grid_points
        As in :func:`.transform_tables.forward_tables`.

    Raises
    ------
    InvalidInput
        Naming the parameter and what is allowed.
    """
    found = []
    for layer in layers:
        path, geometry = layer.path, layer.geometry
        at_film = response and (_AtFilm(path, response) if path.overlying else response)
        highest = geometry.highest_frequency or max_frequency
        tables = forward_tables(
            geometry, dtype, tolerance=tolerance, window=window, max_frequency=highest, response=at_film
        )
        way = None
        if path.overlying:
            way = plan_extrapolation(
                path, layer.gap, source=geometry.samples, samples=film.samples, interval=film.sampling_interval,
                time_zero=film.time_zero,
            )  # fmt: skip
        found.append(LayerTables(tables, layer.slices, way, _own_attenuation(layer)))
    whole = forward_tables(
        film, dtype, tolerance=tolerance, window=window, max_frequency=None, response=None,
        on_grid_points=on_grid_points,
    )  # fmt: skip
    return whole, found


def _own_attenuation(layer: LayerGeometry) -> NDArray[np.float64] | None:
    own, g = Medium([replace(layer.path.layers[-1], thickness=None)]), layer.geometry
    if not own.lossy:
        return None
    return attenuation_matrix(own, samples=g.samples, interval=g.sampling_interval, time_zero=g.time_zero)


@dataclass(frozen=True, slots=True)
class _AtFilm:
    """Response of the film over the angle within a deeper layer."""

    path: LayerPath
    response: FilmResponse

    def evaluate(
        self, frequencies: NDArray[np.float64], sines: NDArray[np.float64], sound_speed: float
    ) -> NDArray[np.complex128]:
        first = self.path.layers[0].sound_speed
        at_film = np.minimum(np.asarray(sines) * (first / self.path.sound_speed), 1.0)
        return self.response.evaluate(frequencies, at_film, first)
