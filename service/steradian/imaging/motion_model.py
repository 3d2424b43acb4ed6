"""Model of A-lines of a moving object: misfit of each A-line and its derivatives by the object's shift."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging import validation as checks
from steradian.imaging.acquisition import Acquisition, AcquisitionGeometry
from steradian.imaging.engines.array_namespace import to_numpy
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.options import Compute, DirectMethod, ImageGrid, Nufft
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.signal.bandwidth import signal_band
from steradian.imaging.volume import Volume

Floats = NDArray[np.float64]
THRESHOLD = 0.15
"""Share of the image's maximum that is taken away: streaks and noise below it are not the object."""
PLANES = (15e-6, 30e-6)
"""Least and greatest distance of the planes between which depth shifts are interpolated, in m."""


@dataclass(frozen=True, eq=False)
class MovingObject:
    """A-lines with the times of their shots, and the planes of depth shifts.

    Parameters
    ----------
    positions, times, traces
        Sensors (M, 2) in m, times of the shots (M,) in s, and A-lines (M, N_t).
    weights
        Areas of the sensors' cells (M,); None: Voronoi cells.
    geometry
        Sensors and timing, without weights.
    grid, compute
        Voxels and execution options.
    gap, planes
        Distance and places of the planes in m.
    """

    positions: Floats
    times: Floats
    traces: NDArray[np.float32]
    weights: Any
    geometry: AcquisitionGeometry
    grid: ImageGrid
    compute: Compute
    gap: float
    planes: Floats

    @classmethod
    def of(
        cls, acquisition: Acquisition, times: ArrayLike, grid: ImageGrid, reach: float, compute: Compute
    ) -> MovingObject:
        """Return the model of an acquisition for depth shifts up to ``reach``; raises :class:`InvalidInput`."""
        if len(acquisition.medium.layers) > 1:
            raise InvalidInput("medium", str(acquisition.medium), "one layer, for a moving object")
        if acquisition.sensitivity is not None:
            raise InvalidInput("sensitivity", "an array", "None for a moving object: divide the A-lines")
        if not 20e-6 <= reach <= 1e-3:
            raise InvalidInput("reach", reach, "2e-05 to 0.001 m")
        places, weights, aperture = checks.resolve_sensors(
            acquisition.sensors, acquisition.weights, acquisition.aperture
        )
        positions = checks.check_positions(places)
        count = len(positions)
        if positions.shape[1] != 2:
            raise InvalidInput("sensors", f"{count} on a line", "sensors on a plane")
        shots = checks.as_float64("times", times, f"one time a sensor, shape ({count},)")
        if shots.shape != (count,) or not np.ptp(shots) > 0:
            raise InvalidInput("times", f"shape {shots.shape}", f"({count},), not all the same")
        traces = np.asarray(to_numpy(acquisition.traces), np.float32) * np.float32(acquisition.scale)
        geometry = replace(acquisition.geometry, sensors=positions, aperture=aperture, weights=None)
        band, _ = signal_band(traces, acquisition.dt)
        gap = float(np.clip(acquisition.sound_speed / (2.5 * max(band, 1.0)), *PLANES))
        side = ceil(reach / gap) + 2
        planes = gap * np.arange(-side, side + 1, dtype=np.float64)
        return cls(positions, shots, traces, weights, geometry, grid, compute, gap, planes)

    def part(self, which: NDArray[np.int64]) -> MovingObject:
        """Return the model of some A-lines, with weights scaled to the same sum."""
        weights = self.weights
        if weights is not None:
            weights = np.asarray(weights, np.float64)
            weights = weights[which] * (weights.sum() / weights[which].sum())
        geometry = replace(self.geometry, sensors=self.positions[which])
        times, traces = self.times[which], self.traces[which]
        return replace(
            self, positions=self.positions[which], times=times, traces=traces, weights=weights, geometry=geometry
        )

    def image(self, shifts: Floats, method: DirectMethod = Nufft()) -> Volume:
        """Return the image with the shifts (M, 3) undone."""
        geometry = replace(self._moved(shifts), weights=self.weights)
        plan = ReconstructionPlan(geometry, self.grid, method, compute=self.compute)
        shares, _ = self._shares(shifts[:, 2])
        total: Any = None
        volume: Volume | None = None
        for plane, share in zip(self.planes, shares.T, strict=True):
            if not share.any():
                continue
            made = plan.run(self.traces * share[:, None].astype(np.float32))
            assert isinstance(made, Volume)  # noqa: S101 - one set of traces
            volume = made
            part = _shifted_in_depth(made.values, -plane / made.spacing[-1])
            total = part if total is None else total + part
        assert volume is not None  # noqa: S101 - shares sum to 1
        return replace(volume, values=total.astype(np.float32))

    def normal_equations(self, shifts: Floats) -> tuple[Floats, Floats]:
        """Return gradient (M, 3) and curvature (M, 3, 3) of each A-line's misfit about the shifts (M, 3)."""
        volume = self.image(shifts)
        values = np.asarray(volume.values, np.float64)
        body = np.maximum(values - THRESHOLD * values.max(), 0.0)
        model = ForwardOperator(self._moved(shifts), self.grid, tolerance=1e-3, compute=self.compute)
        slopes = [-_derivative(body, axis, volume.spacing[axis]) for axis in (0, 1)]
        shares, rises = self._shares(shifts[:, 2])
        predicted = np.zeros(self.traces.shape)
        changes = np.zeros((3, *self.traces.shape))
        for plane, share, rise in zip(self.planes, shares.T, rises.T, strict=True):
            if not (share.any() or rise.any()):
                continue
            by = plane / volume.spacing[-1]
            heard = model.forward(_shifted_in_depth(body, by))
            predicted += share[:, None] * heard
            changes[2] += rise[:, None] * heard
            for axis in (0, 1):
                changes[axis] += share[:, None] * model.forward(_shifted_in_depth(slopes[axis], by))
        size = float(np.vdot(predicted, predicted))
        brightness = float(np.vdot(predicted, self.traces)) / size if size else 0.0
        left = self.traces - brightness * predicted
        changes *= brightness
        return np.einsum("imn,mn->mi", changes, left), np.einsum("imn,jmn->mij", changes, changes)

    def _moved(self, shifts: Floats) -> AcquisitionGeometry:
        return replace(self.geometry, sensors=self.positions - shifts[:, :2], wrap=True)

    def _shares(self, depths: Floats) -> tuple[Floats, Floats]:
        """Return cubic Lagrange weights (M, planes) of depth shifts in m, and their derivatives in 1/m."""
        place = depths / self.gap + len(self.planes) // 2
        low = np.clip(np.floor(place).astype(np.int64), 1, len(self.planes) - 3)
        f = place - low
        weights = [-f * (f - 1) * (f - 2) / 6, (f + 1) * (f - 1) * (f - 2) / 2]
        weights += [-(f + 1) * f * (f - 2) / 2, (f + 1) * f * (f - 1) / 6]
        slopes = [-(3 * f**2 - 6 * f + 2) / 6, (3 * f**2 - 4 * f - 1) / 2]
        slopes += [-(3 * f**2 - 2 * f - 2) / 2, (3 * f**2 - 1) / 6]
        shares, rises = np.zeros((2, len(depths), len(self.planes)))
        rows = np.arange(len(depths))
        for n, (weight, slope) in enumerate(zip(weights, slopes, strict=True)):
            shares[rows, low - 1 + n] = weight
            rises[rows, low - 1 + n] = slope / self.gap
        return shares, rises


def _shifted_in_depth(values: Any, slices: float) -> Any:
    """Return an image moved deeper by a number of slices, zero beyond its ends."""
    count = values.shape[-1]
    phase = np.exp(-2j * np.pi * np.fft.rfftfreq(2 * count) * slices)
    moved = np.fft.irfft(np.fft.rfft(values, 2 * count, axis=-1) * phase, 2 * count, axis=-1)
    return moved[..., :count].astype(np.float32)


def _derivative(values: Any, axis: int, step: float) -> Any:
    """Return the derivative along a lateral axis, of the periodic band-limited image."""
    waves = 2j * np.pi * np.fft.fftfreq(values.shape[axis]) / step
    shape = [-1 if other == axis else 1 for other in range(values.ndim)]
    return np.fft.ifft(np.fft.fft(values, axis=axis) * waves.reshape(shape), axis=axis).real
