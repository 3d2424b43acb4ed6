"""Speed of sound by least squares: misfit between A-lines and a non-negative image, minimised over the speed.

At each speed tried, A-lines of an image are fitted to the measured ones with the exact forward model. The image is
kept non-negative and within a support: the voxels above a tenth of the maximum of a fit at the speed before, and
their neighbours. Without the support, slow speeds fit better, as their images have more freedom. Depths are held as
times of flight, so that the support fits all speeds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
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

SPACING, MOST_MODES = 100e-6, 48
"""Lateral spacing of the image in m, and most modes; the A-lines are low-passed to what they carry."""
MOST_SENSORS, MOST_PADDING = 6000, 6.0
"""Beyond these, sensors are drawn at random, and the fit is not made."""
SUPPORT, SUPPORT_STEPS, STEPS = 0.1, 16, 32
"""Share of the maximum that the support begins at; iterations to find it, and within it."""
SPREAD, ENOUGH, ROUNDS = 0.01, 0.0015, 7
"""Distance of the three speeds of a round, change that ends the rounds, each as a share of the speed; most rounds."""
MOST_STEPS = ROUNDS * (SUPPORT_STEPS + 3 * STEPS)
"""Iterations of all rounds at most."""
BRIGHTEST = 100
"""Voxels whose arrival times tell the trade with a delay."""
SCALE, DRIFT, LEAST = 1.25, 1.0, 2e-4
"""The standard error, in squares: that of noise, the second half of the iterations' change, and a share of the speed.

The factors were chosen on 60 made scans other than those of docs/sound-speed.md."""

Floats = NDArray[np.float32]
Tell = Callable[[], None]


@dataclass(frozen=True)
class FittedSpeed:
    """Speed of sound of the least misfit, with standard error and sensitivity to a delay.

    Parameters
    ----------
    speed, standard_error
        In m/s; the error is that of noise and of the model's limits.
    speed_per_delay
        Change of the speed found when the record is taken to begin later than it did, in m/s per s.
    """

    speed: float
    standard_error: float
    speed_per_delay: float


class SpeedFit:
    """Least-squares fit of the speed of sound of a recording: fits an image at each candidate speed.

    Parameters
    ----------
    traces, positions, interval, aperture, depth_times, time_zero
        As in :func:`.sound_speed.find_sound_speed`, for sensors on a plane.
    speeds
        Slowest and fastest allowed, in m/s.
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
        speeds: tuple[float, float],
        depth_times: tuple[float, float] | None,
        time_zero: float,
        tell: Tell,
    ) -> None:
        self._tell = tell
        self._speeds, self._aperture = speeds, float(np.max(aperture))
        which = np.arange(len(positions))
        if len(which) > MOST_SENSORS:
            which = np.sort(np.random.default_rng(0).choice(which, MOST_SENSORS, replace=False))
        before = max(0, int(np.ceil(-time_zero / interval)))
        data = np.asarray(traces, np.float32)[which, before:]
        self._positions, self._zero = positions[which], time_zero + before * interval
        self._modes = int(np.clip(round(self._aperture / SPACING), 24, MOST_MODES))
        carried = 0.5 * self._modes / self._aperture * speeds[0]
        limit = min(signal_band(data, interval)[0], carried)
        factor = decimation_factor(limit, interval)
        self._interval = factor * interval
        data = decimate(data, factor, "float32")
        frequencies = np.fft.rfftfreq(2 * data.shape[1], self._interval)
        self._gain = np.cos(np.pi / 2 * np.clip((frequencies / limit - 0.6) / 0.4, 0, 1)) ** 2
        largest = float(np.abs(data).max(initial=0.0))
        if not largest > 0:
            raise InvalidInput("traces", "all zero", "A-lines that hold sound")
        self._data = data / largest
        extent = Extent.of(data.shape[1], self._interval, self._zero)
        end = (extent.end - 1) * self._interval
        farthest = float(np.linalg.norm(np.abs(self._positions).max(axis=0) + self._aperture / 2))
        nearest = np.sqrt(max(0.0, self._zero**2 - (farthest / speeds[0]) ** 2))
        near = max(nearest, 2 * self._aperture / self._modes / speeds[0])
        self._times = (near, end) if depth_times is None else self._between_slices(*depth_times, end)
        self._curvature: float | None = None
        self._needed_padding(speeds[1])

    def model(self, speed: float) -> ForwardOperator:
        """Create the forward model at a speed of sound."""
        geometry = AcquisitionGeometry(
            self._positions,
            self._data.shape[1],
            dt=self._interval,
            sound_speed=speed,
            t0=self._zero,
            aperture=self._aperture,
        )
        grid = ImageGrid(self._modes, depth=(self._times[0] * speed, self._times[1] * speed))
        return ForwardOperator(geometry, grid, tolerance=1e-3, compute=Compute(device="cpu"))

    def find(self, start: float) -> FittedSpeed:
        """Return the speed of the least misfit, by iteration from a nearby speed."""
        speed = start
        for _ in range(ROUNDS):
            image, _ = self._fit(speed, None, SUPPORT_STEPS)
            support = binary_dilation(image > SUPPORT * image.max())
            fits = [self._fit(speed * (1 + offset), support, STEPS) for offset in (-SPREAD, 0.0, SPREAD)]
            half, _ = _least([misfits[0] for _, misfits in fits])
            whole, noise = _least([misfits[1] for _, misfits in fits])
            drift = whole - half
            step = float(np.clip(whole + drift, -3 * SPREAD, 3 * SPREAD))  # as if iterated without end
            before, speed = speed, float(np.clip(speed * (1 + step), *self._speeds))
            if abs(speed - before) < ENOUGH * speed:
                break
        error = speed * float(np.linalg.norm([SCALE * noise, DRIFT * drift, LEAST]))
        return FittedSpeed(speed, error, self._speed_per_delay(fits[1][0], speed))

    def _fit(self, speed: float, support: NDArray[np.bool_] | None, steps: int) -> tuple[Floats, list[Any]]:
        """Return the image of least misfit (accelerated projected gradients), and misfits halfway and at the end."""
        model = self.model(speed)
        if self._curvature is None:
            self._curvature = self._largest_curvature(model)
        image = ahead = np.zeros(model.volume_shape, np.float32)
        momentum, misfits = 1.0, []
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
                left = self._filtered(model.forward(image) - self._data)
                misfits.append(np.sum(np.square(left, dtype=np.float64), axis=1))
        return image, misfits

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
        axes = self.model(speed).geometry.axes()
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

    def _needed_padding(self, speed: float) -> None:
        """Raise InvalidInput for a record whose length would need too much padding in the model."""
        duration = self._data.shape[1] * self._interval + self._zero
        needed = artefact_free_padding(
            self._positions, aperture=self._aperture, duration=duration, sound_speed=speed, depth=self._times[0] * speed
        )
        if needed > MOST_PADDING:
            raise InvalidInput("traces", f"{duration:.3g} s long", "a shorter record or a wider aperture")


def _least(misfits: list[NDArray[np.float64]]) -> tuple[float, float]:
    """Return the relative change to the speed of least misfit and its standard error (sandwich estimator)."""
    below, middle, above = misfits
    slopes, curvatures = (above - below) / (2 * SPREAD), (above - 2 * middle + below) / SPREAD**2
    slope, curvature = float(slopes.sum()), float(curvatures.sum())
    if not curvature > 0:
        return -float(np.sign(slope)) * 2 * SPREAD, 2 * SPREAD
    change = float(np.clip(-slope / curvature, -2 * SPREAD, 2 * SPREAD))
    scores = slopes + change * curvatures
    return change, float(np.sqrt(np.sum((scores - scores.mean()) ** 2)) / curvature)
