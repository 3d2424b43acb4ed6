"""Rigid registration of volumes: shift between two images of one object, by cross-correlation to a part of a voxel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.volume import Volume

Floats = NDArray[np.float64]
STEPS = 20
"""Most Newton steps after the whole voxel."""
THRESHOLD = 0.15
"""Share of the maximum that is taken away from the values; only what remains is compared."""
EDGE = 0.1
"""Share of each side over which the images are tapered at both ends: what enters there has not moved."""


@dataclass(frozen=True, eq=False)
class Shift:
    """Shift of an object between two volumes.

    Parameters
    ----------
    metres
        Along each axis of the volumes, in their order; positive: the object moved towards larger coordinates.
    standard_error
        Of each, in m (68 %), from what the shift does not explain.
    """

    metres: tuple[float, ...]
    standard_error: tuple[float, ...]

    @property
    def is_significant(self) -> bool:
        """Whether the shift exceeds twice its standard error along an axis."""
        return any(abs(value) > 2 * error for value, error in zip(self.metres, self.standard_error, strict=True))

    def undo(self, volume: Volume) -> Volume:
        """Return the volume with the object moved back, by a phase in the Fourier domain (periodic at the edges)."""
        spectrum = np.fft.rfftn(volume.values)
        for axis, (value, step) in enumerate(zip(self.metres, volume.spacing, strict=True)):
            frequencies = _frequencies(volume.values.shape, axis)
            spectrum *= np.exp(2j * np.pi * frequencies * (value / step))
        values = np.fft.irfftn(spectrum, volume.values.shape, axes=range(volume.values.ndim))
        return Volume(values.astype(volume.values.dtype), volume.axes, volume.spacing, volume.sound_speed, volume.info)


def estimate_shift(reference: Volume, moved: Volume) -> Shift:
    """Estimate the shift of an object between two volumes on the same voxels, by least squares with one amplitude.

    The maximum of the cross-correlation gives whole voxels, Newton steps on its trigonometric interpolation the rest
    (as M. Guizar-Sicairos, S. T. Thurman and J. R. Fienup, Opt. Lett. 33, 156 (2008)). The error is how far
    parts of the object disagree, which includes deformation.

    Parameters
    ----------
    reference, moved
        Volumes with the same shape and spacing; the object may have another brightness.

    Raises
    ------
    InvalidInput
        If shape or spacing differ, or one is empty.
    """
    if reference.values.shape != moved.values.shape or not np.allclose(reference.spacing, moved.spacing):
        allowed = f"the voxels of the reference, {reference.values.shape}"
        raise InvalidInput("moved", f"a volume of shape {moved.values.shape}", allowed)
    first, second = _object(reference.values), _object(moved.values)
    if not (first.any() and second.any()):
        raise InvalidInput("volumes", "all zero", "images with an object")
    shape, axes = reference.values.shape, range(reference.values.ndim)
    spectrum = np.fft.rfftn(second)
    cross = np.conj(np.fft.rfftn(first)) * spectrum
    correlation = np.fft.irfftn(cross, shape, axes=axes)
    peak = np.unravel_index(int(correlation.argmax()), shape)
    shift = np.array([at if at <= side // 2 else at - side for at, side in zip(peak, shape, strict=True)], np.float64)
    waves = [2 * np.pi * _frequencies(shape, axis) for axis in axes]
    shift = _refined(cross, waves, shift)
    spectrum *= np.exp(1j * sum(wave * by for wave, by in zip(waves, shift, strict=True)))
    error = _errors(first, np.fft.irfftn(spectrum, shape, axes=axes))
    spacing = np.array(reference.spacing)
    return Shift(tuple(map(float, shift * spacing)), tuple(map(float, error * spacing)))


def _refined(cross: Any, waves: list[Floats], shift: Floats) -> Floats:
    """Return the maximum of the interpolated cross-correlation near a shift, in voxels, by Newton's method."""
    start = shift.copy()
    for _ in range(STEPS):
        turned = _counted(cross * np.exp(1j * sum(wave * by for wave, by in zip(waves, shift, strict=True))))
        imaginary = turned.imag
        slope = np.array([-np.sum(wave * imaginary) for wave in waves])
        curvature = np.array([[-np.sum(one * other * turned.real) for other in waves] for one in waves])
        if not (np.linalg.eigvalsh(curvature) < 0).all():
            return start
        step = -np.linalg.solve(curvature, slope)
        shift = start + np.clip(shift + step - start, -1, 1)
        if np.abs(step).max() < 1e-6:
            break
    return shift


def _errors(first: Floats, turned_back: Floats) -> Floats:
    """Return standard errors in voxels from how far parts of the object disagree (sandwich estimator over blocks).

    Parameters
    ----------
    first, turned_back
        Prepared images, the second with its shift undone.
    """
    amplitude = float(np.vdot(first, turned_back) / np.vdot(first, first))
    slopes = np.stack([amplitude * each for each in np.gradient(first)])
    left = turned_back - amplitude * first
    block = _blocks(first)
    count = int(block.max()) + 1
    dimensions = first.ndim
    bread = np.zeros((count, dimensions, dimensions))
    scores = np.zeros((count, dimensions))
    for i in range(dimensions):
        scores[:, i] = np.bincount(block.ravel(), (slopes[i] * left).ravel(), count)
        for j in range(dimensions):
            bread[:, i, j] = np.bincount(block.ravel(), (slopes[i] * slopes[j]).ravel(), count)
    inverse = np.linalg.inv(bread.sum(axis=0))
    scores -= np.einsum("bij,j->bi", bread, inverse @ scores.sum(axis=0))
    covariance = inverse @ (scores.T @ scores) @ inverse * count / (count - 1)
    return np.asarray(np.sqrt(np.diag(covariance)), np.float64)


def _blocks(image: Floats) -> NDArray[np.int64]:
    """Return the number of each voxel's block: thirds of the object's energy along each axis."""
    block = np.zeros(image.shape, np.int64)
    for axis in range(image.ndim):
        energy = np.square(image).sum(axis=tuple(other for other in range(image.ndim) if other != axis))
        third = np.minimum(3 * np.cumsum(energy) / energy.sum(), 2.999).astype(np.int64)
        block = 3 * block + third.reshape([-1 if other == axis else 1 for other in range(image.ndim)])
    return block


def _counted(spectrum: Any) -> Any:
    """Return a half spectrum with its inner frequencies twice, as in the whole one."""
    weights = np.full(spectrum.shape[-1], 2.0)
    weights[0] = 1.0
    return spectrum * weights


def _frequencies(shape: tuple[int, ...], axis: int) -> Floats:
    """Return the frequencies of a half spectrum along an axis, in cycles a voxel, ready to broadcast."""
    count = shape[axis]
    values = np.fft.rfftfreq(count) if axis == len(shape) - 1 else np.fft.fftfreq(count)
    return np.asarray(values.reshape([-1 if other == axis else 1 for other in range(len(shape))]), np.float64)


def _object(values: Any) -> Floats:
    """Return the part of an image above a threshold, with smooth edges.

    Streaks and noise below it do not move with the object: they would bias the shift, by 20 µm of 300.
    """
    found = np.asarray(values, np.float64)
    found = np.maximum(found - THRESHOLD * found.max(initial=0.0), 0.0)
    for axis, count in enumerate(found.shape):
        rise = max(1, round(EDGE * count))
        window = np.ones(count)
        window[:rise] = np.sin(np.pi / 2 * (np.arange(rise) + 0.5) / rise) ** 2
        window[count - rise :] = window[:rise][::-1]
        found *= window.reshape([-1 if other == axis else 1 for other in range(found.ndim)])
    return np.asarray(found, np.float64)
