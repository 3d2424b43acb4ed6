"""Coarse images of a recording at candidate speeds of sound, and their sharpness."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import Cancelled
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import Acquisition, Compute, ImageGrid, Nufft, reconstruct
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.signal.bandwidth import decimate, decimation_factor, signal_band
from steradian.quality import tenenbaum

SPACING = 120e-6
"""Lateral spacing of the images compared, in m, unless fewer modes are asked for."""
_STAGE = "sound speed"


class Views:
    """Coarse images of a recording at candidate speeds of sound, for autofocus."""

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
    ) -> None:
        most = max(32, round(aperture / SPACING))
        self._modes = most if modes is None else min(modes, most)
        highest, _ = signal_band(traces, interval)
        # a grid of that spacing carries waves along the film up to half a wave a point; 1500 m/s will do here
        carried = 0.5 * self._modes / aperture * 1500.0
        factor = decimation_factor(min(highest, carried), interval)
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
        which = slice(None) if some is None else some
        weights = self._weights
        if isinstance(weights, np.ndarray) and some is not None:
            weights = weights[some] * (weights.sum() / weights[some].sum())
        acquisition = Acquisition(
            self._traces[which],
            self._positions[which],
            dt=self._interval,
            sound_speed=speed,
            t0=self._zero,
            aperture=self._aperture,
            weights=weights,
        )
        grid = ImageGrid(self._modes, depth=self._depths(speed))
        volume = reconstruct(acquisition, grid, Nufft(tolerance=1e-3), compute=Compute(device="cpu"))
        image = np.maximum(volume.mip("z") if volume.dimensions == 3 else volume.values, 0)
        self.tell()
        square = float(np.mean(np.square(image, dtype=np.float64)))
        return tenenbaum(image) / square if square else 0.0

    def _depths(self, speed: float) -> tuple[float, float] | None:
        if self._times is None:
            return None
        end = (Extent.of(self._traces.shape[1], self._interval, self._zero).end - 1) * self._interval
        return self._times[0] * speed, min(self._times[1], end) * speed
