"""Coarse images of a recording at candidate speeds of sound or media, and their sharpness."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import hilbert
from scipy.signal.windows import tukey

from steradian.core.exceptions import Cancelled
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import Acquisition, Compute, ImageGrid, Layer, Medium, Nufft, Volume, reconstruct
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.signal.bandwidth import decimate, decimation_factor, signal_band
from steradian.quality import tenenbaum

SPACING = 120e-6
"""Lateral spacing of the images compared, in m, unless fewer modes are asked for."""
TAPER = 0.1
"""Share of a layer's image that is tapered at each end."""
_STAGE = "sound speed"


class Views:
    """Coarse images of a recording at candidate speeds of sound or media, for autofocus.

    Parameters
    ----------
    traces, positions, interval, aperture, modes, weights, depth_times, time_zero
        As in :func:`.sound_speed_search.find_sound_speed`.
    all_frequencies
        Keep all frequencies of the sound, and not only those that the lateral grid carries at any angle.
    """

    def __init__(
        self,
        traces: NDArray[Any],
        positions: NDArray[np.float64],
        interval: float,
        aperture: float,
        modes: int | None,
        weights: Any,
        depth_times: tuple[float, float] | None,
        time_zero: float,
        *,
        all_frequencies: bool = False,
    ) -> None:
        most = max(32, round(aperture / SPACING))
        self._modes = most if modes is None else min(modes, most)
        highest, _ = signal_band(traces, interval)
        # a grid of that spacing carries waves along the film up to half a wave a point; 1500 m/s will do here
        carried = 0.5 * self._modes / aperture * 1500.0
        factor = decimation_factor(highest if all_frequencies else min(highest, carried), interval)
        self._traces = decimate(traces, factor, "float32")
        self._interval = interval * factor
        self._positions, self._aperture = positions, aperture
        self._weights, self._times, self._zero = weights, depth_times, time_zero
        self._done = self._total = 0
        self._progress: Progress | None = None
        self._cancelled: CancelCheck | None = None

    def report(self, progress: Progress | None, cancelled: CancelCheck | None, total: int) -> None:
        """Set the progress and cancellation callbacks and the total number of steps."""
        self._progress, self._cancelled, self._total = progress, cancelled, total

    def tell(self) -> None:
        """Report one step to the progress callback; raise ``Cancelled`` on cancellation."""
        if self._cancelled is not None and self._cancelled():
            raise Cancelled(f"cancelled during: {_STAGE}")
        self._done += 1
        if self._progress is not None:
            self._progress(_STAGE, self._done, self._total)

    def finish(self) -> None:
        """Report all remaining steps as done."""
        self._done = self._total - 1
        self.tell()

    def sharpness(self, speed: float, some: NDArray[np.bool_] | None = None) -> float:
        """Return the sharpness of the image at a speed, reconstructed from all sensors or a subset."""
        medium = Medium([Layer(speed)])
        image = np.maximum(self.projection(medium, self._zero, self._times, some), 0)
        square = float(np.mean(np.square(image, dtype=np.float64)))
        return tenenbaum(image) / square if square else 0.0

    def lateral_sharpness(
        self,
        medium: Medium,
        time_zero: float,
        times: tuple[float, float],
        some: NDArray[np.bool_] | None = None,
    ) -> tuple[float, float]:
        """Return two measures of the sharpness of the image's envelope along the film.

        Parameters
        ----------
        medium, time_zero
            Candidate.
        times
            Times of flight in s between which the image lies; its ends are tapered.
        some
            (M,) sensors used; None: all.

        Returns
        -------
        Kurtosis of the amplitude along the film, averaged over depth by energy; and mean square of the amplitude's
        difference between neighbours along x, relative to its own.
        """
        values = self.image(medium, time_zero, times, some, lateral_padding=2.0).values
        image = np.asarray(values, np.float64) * tukey(values.shape[-1], 2 * TAPER)
        amplitude = np.abs(hilbert(image, axis=-1))
        power = np.square(amplitude).reshape(-1, image.shape[-1])
        mean = power.mean(axis=0)
        loud = mean > 0
        if not loud.any():
            return 0.0, 0.0
        peaked = np.mean(power[:, loud] ** 2, axis=0) / mean[loud]
        steps = np.mean(np.square(np.diff(amplitude, axis=0)))
        return float(peaked.sum() / mean.sum()), float(steps / power.mean())

    def projection(
        self, medium: Medium, time_zero: float, times: tuple[float, float] | None, some: NDArray[np.bool_] | None
    ) -> NDArray[Any]:
        """Return the z-projection of the image, in 2-D the image itself."""
        volume = self.image(medium, time_zero, times, some)
        return np.asarray(volume.mip("z") if volume.dimensions == 3 else volume.values)

    def image(
        self,
        medium: Medium,
        time_zero: float,
        times: tuple[float, float] | None,
        some: NDArray[np.bool_] | None = None,
        *,
        lateral_padding: float | None = None,
    ) -> Volume:
        """Return the image of a medium between two times of flight, reconstructed from all sensors or a subset."""
        which = slice(None) if some is None else some
        weights = self._weights
        if isinstance(weights, np.ndarray) and some is not None:
            weights = weights[some] * (weights.sum() / weights[some].sum())
        acquisition = Acquisition(
            self._traces[which],
            self._positions[which],
            dt=self._interval,
            medium=medium,
            t0=time_zero,
            aperture=self._aperture,
            weights=weights,
        )
        grid = ImageGrid(self._modes, depth=self._depths(medium, time_zero, times), lateral_padding=lateral_padding)
        volume = reconstruct(acquisition, grid, Nufft(tolerance=1e-3), compute=Compute(device="cpu"))
        self.tell()
        return volume

    def _depths(
        self, medium: Medium, time_zero: float, times: tuple[float, float] | None
    ) -> tuple[float, float] | None:
        if times is None:
            return None
        end = (Extent.of(self._traces.shape[1], self._interval, time_zero).end - 1) * self._interval
        return medium.depth_at(times[0]), medium.depth_at(min(times[1], end))
