"""Medium by least squares: misfit between A-lines and a non-negative image, minimised over speeds and thicknesses.

At each candidate, A-lines of an image are fitted to the measured ones with the exact forward model. The image is
kept non-negative and within a support: the voxels above a tenth of the maximum of a fit at the candidate before, and
their neighbours. Without the support, slow speeds fit better, as their images have more freedom. Depths are held as
times of flight, so that the support fits all candidates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, floor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from steradian.core.exceptions import InvalidInput
from steradian.imaging import AcquisitionGeometry, Compute, ImageGrid
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.geometry.model import artefact_free_padding
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.signal.bandwidth import decimate, decimation_factor, signal_band
from steradian.reconstructions.studies.medium_unknowns import MediumState, Unknown
from steradian.reconstructions.studies.misfit_minimum import least
from steradian.reconstructions.studies.timed_operator import TimedOperator

SPACING, MOST_MODES, LAYERED_MODES = 100e-6, 48, 32
"""Lateral spacing of the image in m, and most modes, of one layer and of several; A-lines are low-passed to it."""
MOST_SENSORS, MOST_PADDING = 6000, 6.0
"""Beyond these, sensors are drawn at random, and the fit is not made."""
SUPPORT, SUPPORT_STEPS, STEPS = 0.1, 16, 32
"""Share of the maximum that the support begins at; iterations to find it, and within it."""
SPREAD, ENOUGH, ROUNDS = 0.01, 0.0015, 7
"""Distance of the three speeds of a round, change that ends the rounds, each as a share of the speed; most rounds."""
THICKNESS_SPREAD = 0.05
"""The same distance of thicknesses, which change the misfit less."""
BRIGHTEST = 100
"""Voxels whose arrival times tell the trade with a delay."""
SCALE, DRIFT, LEAST = (1.25, 3.0), 1.0, (2e-4, 1e-3)
"""The standard error, in squares: that of noise, the second half of the iterations' change, and a share of the speed.

The factors of one layer were chosen on 60 made scans other than those of docs/sound-speed.md, of several on six."""

Floats = NDArray[np.float32]
Floats64 = NDArray[np.float64]
Tell = Callable[[], None]


def most_steps(unknowns: int) -> int:
    """Return the largest number of iterations of a fit with this number of parameters."""
    return ROUNDS * (SUPPORT_STEPS + (2 * unknowns + 1) * STEPS)


@dataclass(frozen=True)
class FittedState:
    """Parameters of the least misfit, with their covariance.

    Parameters
    ----------
    values
        (P,) in SI units.
    covariance
        (P, P) of noise and of the model's limits.
    curves
        For each parameter three values and the misfits there, relative to the A-lines, all else held.
    speed_per_delay
        For one speed in one medium: its change when the record is taken to begin later than it did, in m/s per s.
    """

    values: Floats64
    covariance: Floats64
    curves: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]
    speed_per_delay: float | None


class MediumFit:
    """Least-squares fit of a medium's parameters to a recording: fits an image at each candidate.

    Parameters
    ----------
    traces, positions, interval, aperture, depth_times
        As in :func:`.sound_speed_search.find_sound_speed`, for sensors on a plane.
    start, unknowns
        Medium and time zero, and which parameters are varied in which range.
    tell
        Called after each iteration; may raise to end the search.

    Raises
    ------
    InvalidInput
        If the record is so long that the model would need more than ``MOST_PADDING`` times the aperture.
    """

    def __init__(
        self,
        traces: NDArray[Any],
        positions: NDArray[np.float64],
        interval: float,
        aperture: float,
        start: MediumState,
        unknowns: Sequence[Unknown],
        depth_times: tuple[float, float] | None,
        tell: Tell,
    ) -> None:
        self._tell, self._state, self._unknowns = tell, start, tuple(unknowns)
        self._aperture = float(np.max(aperture))
        which = np.arange(len(positions))
        if len(which) > MOST_SENSORS:
            which = np.sort(np.random.default_rng(0).choice(which, MOST_SENSORS, replace=False))
        before = max(0, int(np.ceil(-start.time_zero / interval)))
        data = np.asarray(traces, np.float32)[which, before:]
        self._positions, self._before = positions[which], before * interval
        zero = start.time_zero + self._before
        self._modes = int(
            np.clip(round(self._aperture / SPACING), 24, MOST_MODES if len(start.medium.layers) == 1 else LAYERED_MODES)
        )
        slowest = start.with_values({each: each.low for each in unknowns if each.quantity == "sound_speed"}).medium
        carried = 0.5 * self._modes / self._aperture * slowest.slowest
        limit = min(signal_band(data, interval)[0], carried)
        factor = decimation_factor(limit, interval)
        if len(start.medium.layers) > 1:  # thinner slices, as boundaries cut the sound of a slice
            factor = max(1, factor // 2)
        self._interval = factor * interval
        data = decimate(data, factor, "float32")
        frequencies = np.fft.rfftfreq(2 * data.shape[1], self._interval)
        self._gain = np.cos(np.pi / 2 * np.clip((frequencies / limit - 0.6) / 0.4, 0, 1)) ** 2
        largest = float(np.abs(data).max(initial=0.0))
        if not largest > 0:
            raise InvalidInput("traces", "all zero", "A-lines that hold sound")
        self._data = data / largest
        extent = Extent.of(data.shape[1], self._interval, zero)
        end = (extent.end - 1) * self._interval
        farthest = float(np.linalg.norm(np.abs(self._positions).max(axis=0) + self._aperture / 2))
        nearest = np.sqrt(max(0.0, zero**2 - (farthest / slowest.slowest) ** 2))
        near = max(nearest, 2 * self._aperture / self._modes / slowest.slowest)
        self._times = (near, end) if depth_times is None else self._between_slices(*depth_times, end)
        self._curvature: float | None = None
        self._check_padding(start.with_values({each: each.high for each in unknowns if each.quantity == "sound_speed"}))

    def model(self, state: MediumState) -> ForwardOperator:
        """Create the forward model of a medium; the depths are held as times of flight."""
        medium = state.medium
        geometry = AcquisitionGeometry(
            self._positions,
            self._data.shape[1],
            dt=self._interval,
            medium=medium,
            t0=state.time_zero + self._before,
            aperture=self._aperture,
        )
        options: dict[str, Any] = {"tolerance": 1e-3, "compute": Compute(device="cpu")}
        if len(medium.layers) == 1:
            depths = (self._times[0] * medium.slowest, self._times[1] * medium.slowest)
            return ForwardOperator(geometry, ImageGrid(self._modes, depth=depths), **options)
        first, last = (time / self._interval for time in self._times)
        return TimedOperator(geometry, ImageGrid(self._modes), (ceil(first), floor(last) + 1), **options)

    def find(self, start: MediumState) -> FittedState:
        """Return the parameters of the least misfit, by iteration from a nearby state."""
        state, unknowns = start, self._unknowns
        values = np.array([state.value(each) for each in unknowns])
        lone = len(state.medium.layers) == len(unknowns) == 1 and unknowns[0].quantity == "sound_speed"
        for _ in range(ROUNDS):
            units = np.array([self._unit(each, state) for each in unknowns])
            reach = np.array([0.5 * (each.high - each.low) for each in unknowns]) / units
            image, _ = self._fit(state, None, SUPPORT_STEPS)
            support = binary_dilation(image > SUPPORT * image.max())
            offsets = units * np.eye(len(units))
            below, above = (
                [self._fit(self._shifted(state, way * offset), support, STEPS)[1] for offset in offsets]
                for way in (-1, 1)
            )
            image, here = self._fit(state, support, STEPS)
            half, whole = (
                least(here[stage], [each[stage] for each in below], [each[stage] for each in above], reach)
                for stage in (0, 1)
            )
            drift = whole.within(whole.step - half.step)
            step = np.clip(whole.step + drift, -3, 3)  # as if iterated without end
            before, state = values, self._shifted(state, units * step, clip=True)
            values = np.array([state.value(each) for each in unknowns])
            noise = 0.0 if lone else 0.5 * np.sqrt(np.diag(whole.covariance))
            if (np.abs(values - before) < np.maximum(ENOUGH / SPREAD, noise) * units).all():
                break
        differences, units = units, np.array([self._unit(each, state) for each in unknowns])
        kind = int(len(state.medium.layers) > 1)
        least_error = (LEAST[kind] / SPREAD) ** 2 * np.eye(len(units))
        covariance = SCALE[kind] ** 2 * whole.covariance + DRIFT**2 * np.outer(drift, drift) + least_error
        curves = self._curves(before, differences, here[1], [[each[1] for each in side] for side in (below, above)])
        trade = self._speed_per_delay(image, state.medium.slowest) if lone else None
        return FittedState(values, covariance * np.outer(units, units), curves, trade)

    def _unit(self, unknown: Unknown, state: MediumState) -> float:
        """Return the distance of the differences of a parameter."""
        if unknown.quantity == "time_zero":
            return SPREAD * 0.5 * sum(self._times)
        return (SPREAD if unknown.quantity == "sound_speed" else THICKNESS_SPREAD) * state.value(unknown)

    def _shifted(self, state: MediumState, change: Floats64, *, clip: bool = False) -> MediumState:
        """Return the state with the unknowns changed, limited to their ranges with ``clip``."""
        values = {each: state.value(each) + float(more) for each, more in zip(self._unknowns, change, strict=True)}
        return state.with_values({each: each.clipped(v) if clip else v for each, v in values.items()})

    def _curves(
        self, values: Floats64, units: Floats64, here: Floats, sides: Sequence[Sequence[Floats]]
    ) -> tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]:
        """Return three values of each parameter and the relative misfits there."""
        norm = float(np.linalg.norm(self._filtered(self._data)))
        misfits = [
            [float(np.linalg.norm(left)) / norm for left in (low, here, high)] for low, high in zip(*sides, strict=True)
        ]
        tried = [
            tuple(float(value + way * unit) for way in (-1, 0, 1)) for value, unit in zip(values, units, strict=True)
        ]
        return tuple((one, tuple(other)) for one, other in zip(tried, misfits, strict=True))

    def _fit(self, state: MediumState, support: NDArray[np.bool_] | None, steps: int) -> tuple[Floats, list[Floats]]:
        """Return the image of least misfit (accelerated projected gradients), and residuals halfway and at the end."""
        model = self.model(state)
        if self._curvature is None:
            self._curvature = self._largest_curvature(model)
        image = ahead = np.zeros(model.volume_shape, np.float32)
        momentum, residuals = 1.0, []
        for done in range(1, steps + 1):
            gradient = model.backward(self._filtered(model.forward(ahead) - self._data, 2))
            following = np.maximum(ahead - gradient / np.float32(self._curvature), 0)
            if support is not None:
                following *= support
            grown = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
            if float(np.vdot(ahead - following, following - image)) > 0:  # the momentum leads away: restart
                grown, ahead = 1.0, following
            else:
                ahead = following + np.float32((momentum - 1) / grown) * (following - image)
            image, momentum = following, grown
            self._tell()
            if support is not None and done in (steps // 2, steps):
                residuals.append(self._filtered(model.forward(image) - self._data))
        return image, residuals

    def _filtered(self, traces: Floats, times: int = 1) -> Floats:
        """Apply the low-pass filter to A-lines, ``times`` times."""
        samples = traces.shape[1]
        spectra = np.fft.rfft(traces, 2 * samples, axis=1) * self._gain**times
        return np.fft.irfft(spectra, 2 * samples, axis=1)[:, :samples].astype(np.float32)

    def _largest_curvature(self, model: ForwardOperator) -> float:
        """Return the largest curvature (Lipschitz constant) of the misfit, by power iteration."""
        image = np.random.default_rng(0).standard_normal(model.volume_shape).astype(np.float32)
        norm = 1.0
        for _ in range(10):
            image = model.backward(self._filtered(model.forward(image / np.linalg.norm(image)), 2))
            norm = float(np.linalg.norm(image))
        return 1.1 * norm

    def _speed_per_delay(self, image: Floats, speed: float) -> float:
        """Return the change of the estimated speed per delay of all A-lines, from the brightest voxels.

        A delay is what the speed, the voxel's depth and its place along the film explain together as well as they
        can, in the least-squares sense over the sensors, each with its amplitude squared, 1/r².
        """
        axes = self.model(self._state.with_values({self._unknowns[0]: speed})).geometry.axes()
        brightest = np.argsort(image, axis=None)[-BRIGHTEST:]
        indices = np.unravel_index(brightest, image.shape)
        lines = [axis for axis in (axes.x, axes.y, axes.z) if axis is not None]
        places = [line[index] for line, index in zip(lines, indices, strict=True)]
        powers = image.ravel()[brightest].astype(np.float64) ** 2
        top = bottom = 0.0
        for *lateral, depth, power in zip(*places, powers, strict=True):
            aside = self._positions.reshape(len(self._positions), -1) - np.array(lateral)
            distance = np.sqrt(np.sum(aside**2, axis=1) + depth**2)
            weights = 1 / distance
            along = np.column_stack([aside, np.full(len(aside), depth)]) / distance[:, None] / speed
            own = weights[:, None] * along
            change = weights * distance / speed**2  # arrival time by the speed, the place held
            free = change - own @ np.linalg.lstsq(own, change, rcond=None)[0]
            top += power * float(free @ weights)
            bottom += power * float(free @ free)
        return -top / bottom if bottom > 0 else -float("inf")

    def _between_slices(self, first: float, last: float, end: float) -> tuple[float, float]:
        """Return the times shifted by a quarter slice, so that rounding selects the same slices at all speeds."""
        low, high = (int(time / self._interval + 1e-6) for time in (first, min(last, end)))
        if high < low + 2:
            raise InvalidInput(
                "depth_times", (first, last), f"at least {3 * self._interval:.3g} s apart, by {end:.3g} s"
            )
        return (low + 0.25) * self._interval, (high + 0.25) * self._interval

    def _check_padding(self, fastest: MediumState) -> None:
        """Raise InvalidInput for a record whose length would need too much padding in the model."""
        duration = self._data.shape[1] * self._interval + fastest.time_zero + self._before
        needed = artefact_free_padding(
            self._positions, aperture=self._aperture, duration=duration, sound_speed=fastest.medium.fastest,
            depth=fastest.medium.depth_at(self._times[0]),
        )  # fmt: skip
        if needed > MOST_PADDING:
            raise InvalidInput("traces", f"{duration:.3g} s long", "a shorter record or a wider aperture")
