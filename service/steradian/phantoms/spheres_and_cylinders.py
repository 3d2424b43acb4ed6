"""Phantoms of cylinders and spheres with uniform or Gaussian profile, approximated by sums of Gaussian balls."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fabry_perot.simulator.phantoms import Balls

Array = NDArray[np.float64]
_FINE = 16
"""A ball's s is the diameter over this number."""
_FINEST = 0.6
"""No ball is narrower than this times the distance that sound travels between two samples."""
_PITCH = 1.5
"""Distance of balls over s: their sum is even to 0.1 %."""
EDGE = 12.0
"""The balls' s widens the object as a diameter larger by this times s² (squares): a compromise of the half level
(0) and the second moment (16)."""
_SUBPIXELS = 5
FWHM = float(np.sqrt(8 * np.log(2)))
"""Full width at half maximum of a Gaussian over its s."""


def ball_size(diameter: float, step: float) -> float:
    """Return the s in metres of the balls of an object of a diameter; ``step``: metres between two samples."""
    return max(diameter / _FINE, _FINEST * step)


def cylinder(diameter: float, place: ArrayLike, direction: ArrayLike, half_length: float, step: float) -> Balls:
    """Return a phantom of a straight uniform cylinder of initial pressure 1.

    Parameters
    ----------
    diameter
        In m; 0: a line, as thin as the samples allow.
    place
        x, y, z in m of its middle.
    direction
        Vector (3,) along it.
    half_length
        Distance in m from its middle to either end; what would lie above the sensor plane is left out.
    step
        Distance in m that sound travels between two samples: balls are hardly narrower.
    """
    along = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    s = ball_size(diameter, step)
    basis = np.linalg.svd(along[None])[2][1:]
    grid, share = _covered(diameter, s, 2)
    count = int(np.ceil(half_length / (_PITCH * s)))
    places = np.arange(-count, count + 1)[:, None] * _PITCH * s * along
    centres = np.asarray(place, np.float64) + (places[:, None] + grid @ basis).reshape(-1, 3)
    return _balls(centres, s, np.tile(share, len(places)))


def sphere(diameter: float, place: ArrayLike, step: float) -> Balls:
    """Return a phantom of a uniform sphere of initial pressure 1; parameters as of :func:`cylinder`."""
    s = ball_size(diameter, step)
    grid, share = _covered(diameter, s, 3)
    return _balls(np.asarray(place, np.float64) + grid, s, share)


def gaussian_cylinder(fwhm: float, place: ArrayLike, direction: ArrayLike, half_length: float, step: float) -> Balls:
    """Return a phantom of a straight cylinder with Gaussian profile of peak 1; parameters as of :func:`cylinder`."""
    s = max(fwhm / FWHM, _FINEST * step)
    along = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    count = int(np.ceil(half_length / (_PITCH * s)))
    centres = np.asarray(place, np.float64) + np.arange(-count, count + 1)[:, None] * _PITCH * s * along
    below = centres[:, 2] > 0
    amplitude = _PITCH / np.sqrt(2 * np.pi)
    return Balls(centres[below], np.full(int(below.sum()), s), np.full(int(below.sum()), amplitude))


def gaussian_sphere(fwhm: float, place: ArrayLike, step: float) -> Balls:
    """Return a phantom of one Gaussian ball of peak 1; parameters as of :func:`cylinder`."""
    return Balls(np.asarray([place], np.float64), np.array([max(fwhm / FWHM, _FINEST * step)]), np.ones(1))


def _balls(centres: Array, s: float, amplitudes: Array) -> Balls:
    below = centres[:, 2] > 0
    return Balls(centres[below], np.full(int(below.sum()), s), amplitudes[below] * (_PITCH / np.sqrt(2 * np.pi)) ** 3)


def _covered(diameter: float, s: float, axes: int) -> tuple[Array, Array]:
    """Return grid points (K, axes) in m and the fraction of each point's cell that lies in the disc or sphere."""
    pitch = _PITCH * s
    radius = 0.5 * np.sqrt(max(diameter**2 - EDGE * s**2, 0.0))
    if radius < pitch / 2:
        return np.zeros((1, axes)), np.ones(1)
    count = int(np.ceil(radius / pitch)) + 1
    line = np.arange(-count, count + 1) * pitch
    points = np.stack(np.meshgrid(*[line] * axes, indexing="ij"), axis=-1).reshape(-1, axes)
    inner = ((np.arange(_SUBPIXELS) + 0.5) / _SUBPIXELS - 0.5) * pitch
    offsets = np.stack(np.meshgrid(*[inner] * axes, indexing="ij"), axis=-1).reshape(-1, axes)
    inside = ((points[:, None] + offsets) ** 2).sum(axis=2) <= radius**2
    share = inside.mean(axis=1)
    return points[share > 0], share[share > 0]
