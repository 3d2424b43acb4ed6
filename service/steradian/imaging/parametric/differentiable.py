"""Bases of the differentiable operators of array libraries: transforms by precision, and their fixed factors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.acquisition import AcquisitionGeometry
from steradian.imaging.film_response import FilmResponse
from steradian.imaging.geometry.sensor_sensitivity import check_sensitivity
from steradian.imaging.medium import Medium
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.options import Compute, ImageGrid, Nufft
from steradian.imaging.parametric.models import parametric_forward_model, parametric_inversion
from steradian.imaging.parametric.transform import REACH, ParametricTransform
from steradian.imaging.signal.attenuation import attenuation_derivatives, attenuation_matrix

Floats = NDArray[np.float64]


class DifferentiableModel:
    """Forward model for arrays of float32 and float64, with and without variable parameters.

    Parameters
    ----------
    geometry, grid, response, max_frequency, tolerance, compute
        As in :class:`steradian.ForwardOperator`. ``compute.dtype`` plays no part: products have the precision of their
        arrays. In float64 they are as exact as ``tolerance`` says.

    Attributes
    ----------
    volume_shape, trace_shape
        Shapes of images, [x, y, z] ([x, z] in 2-D), and of A-lines, (M, N_t).

    Raises
    ------
    InvalidInput
        If a parameter is out of range; by products also if a shape or type does not fit, or a parameter cannot vary.

    Notes
    -----
    Variable parameters of products:

    positions
        Sensor positions (M, 2) in m, (M, 1) in 2-D, within the aperture; None: the geometry's.
    sound_speed
        In m/s, one number for each layer; None: the geometry's. Voxels keep their places. The last sample may be sound
        from up to 1.05 times the geometry's distance.
    time_zero
        Time of the first sample after the laser pulse in s; None: the geometry's.
    weights
        Of a direct reconstruction: areas (M,) of the sensors' cells in m² (lengths in m in 2-D); None: the geometry's,
        wherever sensors are.
    """

    def __init__(
        self,
        geometry: AcquisitionGeometry,
        grid: ImageGrid,
        *,
        response: FilmResponse | None = None,
        max_frequency: float | None = None,
        tolerance: float = 1e-4,
        compute: Compute = Compute(),
    ) -> None:
        self._geometry, self._grid, self._compute = _owned(geometry), grid, compute
        self._settings: dict[str, Any] = {
            "response": response, "max_frequency": max_frequency, "tolerance": tolerance
        }  # fmt: skip
        self._plain: dict[str, ForwardOperator] = {}
        self._parametric: dict[tuple[str, bool], ParametricTransform] = {}
        first = self.plain(compute.precision(tolerance))
        self.volume_shape, self.trace_shape = first.volume_shape, first.trace_shape

    def plain(self, dtype: str) -> ForwardOperator:
        """Return the forward operator of a precision, with all of the geometry."""
        if dtype not in self._plain:
            compute = replace(self._compute, dtype=dtype)
            self._plain[dtype] = ForwardOperator(self._geometry, self._grid, compute=compute, **self._settings)
        return self._plain[dtype]

    def parametric(self, dtype: str, *, timed: bool) -> ParametricTransform:
        """Return the model of a precision for variable parameters, without :attr:`sensitivity` and attenuation.

        ``timed``: with variable sound speed or time zero, for which more is padded.
        """
        key = dtype, timed
        if key not in self._parametric:
            compute = replace(self._compute, dtype=dtype)
            self._parametric[key] = parametric_forward_model(
                self._geometry, self._grid, compute=compute, reach=REACH if timed else 1.0, **self._settings
            )
        return self._parametric[key]

    @property
    def sensitivity(self) -> Floats | None:
        """Factors (M,) of the A-lines, or None."""
        given = self._geometry.sensitivity
        return None if given is None else check_sensitivity(given, self.trace_shape[0])

    @property
    def attenuated(self) -> bool:
        """Whether A-lines of :meth:`parametric` are to be multiplied by an attenuation matrix."""
        medium = self._geometry.medium
        return medium.lossy and len(medium.layers) == 1

    def attenuation(self, sound_speed: float | None, time_zero: float | None) -> Floats:
        """Return the attenuation matrix (N_t, N_t), from lossless A-lines as columns to attenuated ones."""
        return attenuation_matrix(*self._medium(sound_speed), **self._timing(time_zero))

    def attenuation_derivatives(self, sound_speed: float | None, time_zero: float | None) -> tuple[Floats, Floats]:
        """Return the derivatives of the attenuation matrix by sound speed and time zero."""
        return attenuation_derivatives(*self._medium(sound_speed), **self._timing(time_zero))

    def _medium(self, sound_speed: float | None) -> tuple[Medium]:
        (layer,) = self._geometry.medium.layers
        return (Medium([layer if sound_speed is None else replace(layer, sound_speed=sound_speed)]),)

    def _timing(self, time_zero: float | None) -> dict[str, Any]:
        g = self._geometry
        return {"samples": g.samples, "interval": g.dt, "time_zero": g.t0 if time_zero is None else time_zero}


class DifferentiableInversion:
    """Direct reconstruction for arrays of float32 and float64, with variable parameters.

    The image is that of :func:`steradian.reconstruct` with the same geometry, grid and method, to the tolerance, but
    for lateral waves at the Nyquist frequency of an even number of modes, which are left out.

    Parameters
    ----------
    geometry
        Sensors with their weights, and timing, in one lossless medium.
    grid
        Voxels, without ``upsampling``.
    method
        NEDNER-NUFFT, without a film's correction; ``max_frequency`` a number or None.
    compute
        As in :class:`DifferentiableModel`.

    Attributes
    ----------
    volume_shape, trace_shape
        As in :class:`DifferentiableModel`.
    weights
        Areas (M,) of the sensors' cells in m² (lengths in m in 2-D).

    Raises
    ------
    InvalidInput
        If a parameter is out of range.
    """

    def __init__(
        self,
        geometry: AcquisitionGeometry,
        grid: ImageGrid,
        method: Nufft = Nufft(),
        *,
        compute: Compute = Compute(),
    ) -> None:
        if not isinstance(method, Nufft):
            raise InvalidInput("method", type(method).__name__, "Nufft")
        if geometry.medium.lossy:
            raise InvalidInput("medium", str(geometry.medium), "one without attenuation: compensate the A-lines first")
        self._geometry, self._grid, self._method, self._compute = _owned(geometry), grid, method, compute
        self._parametric: dict[str, ParametricTransform] = {}
        first = self.parametric(compute.precision(method.tolerance))
        self.volume_shape, self.trace_shape = first.volume_shape, first.trace_shape
        self.weights: Floats = first.geometry.weights

    def parametric(self, dtype: str) -> ParametricTransform:
        """Return the transpose of the inversion of a precision, for unit weights."""
        if dtype not in self._parametric:
            compute = replace(self._compute, dtype=dtype)
            self._parametric[dtype] = parametric_inversion(self._geometry, self._grid, self._method, compute=compute)
        return self._parametric[dtype]


def _owned(geometry: AcquisitionGeometry) -> AcquisitionGeometry:
    """Return the geometry with arrays of its own, because transforms are made of them later, too."""
    names = [name for name in ("sensors", "weights", "sensitivity") if isinstance(getattr(geometry, name), np.ndarray)]
    return replace(geometry, **{name: getattr(geometry, name).copy() for name in names})


def check_array(name: str, dtype: str, shape: tuple[int, ...], wanted: tuple[int, ...]) -> str:
    """Return the precision of an array of a wanted shape after any batch axes.

    Raises
    ------
    InvalidInput
        If it has another shape, or is of neither float32 nor float64.
    """
    if dtype not in ("float32", "float64"):
        raise InvalidInput(name, f"an array of {dtype}", "float32 or float64")
    if shape[-len(wanted) :] != wanted:
        raise InvalidInput(name, f"an array of shape {shape}", f"shape {wanted}, after any batch axes")
    return dtype
