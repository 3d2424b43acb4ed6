"""Coarse reconstruction parameters for live previews: fewer, nearly isotropic voxels.

A digitiser samples depth finer (12 µm at 8 ns) than sensors and modes sample the plane (60 µm in the paper's yarn). A
preview keeps the lateral pixels and takes the frequencies of the A-lines only as far as a depth step of that size
carries them, which leaves a quarter of the voxels or less.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.imaging import DirectMethod
from steradian.reconstructions.pipeline.resolve import ReconstructionSetup

DEPTH_TO_LATERAL = 0.8
"""Largest depth step in lateral spacings: κ then still reaches beyond the largest lateral mode."""
MAX_VOXELS = 0.25
"""Share of the full image's voxels a preview may have."""
MAX_RATIO = (1.0, 1.25, 1.5, 2.0, 3.0, 4.0)
"""Lateral spacings tried, in those of the full image."""


@dataclass(frozen=True)
class CoarseParameters:
    """Parameters of a live preview that is coarser than the full image: lateral modes and decimation.

    Attributes
    ----------
    modes
        Lateral modes an axis.
    decimation
        Samples of an A-line that become one.
    """

    modes: int
    decimation: int

    def apply(self, full: ReconstructionSetup) -> ReconstructionSetup:
        """Return the reconstruction arguments of the preview, derived from those of a full direct reconstruction."""
        geometry, grid, method, compute = full
        assert isinstance(method, DirectMethod)  # noqa: S101 - of an image that is a sum over sensors
        interval = self.decimation * geometry.dt
        depth, highest, depth_step = grid.depth, method.max_frequency, grid.depth_step
        if depth is not None:  # the last slice may lie between two of the preview's
            step = interval * geometry.sound_speed
            depth = (step * (depth[0] // step), step * (depth[1] // step))
        if self.decimation > 1:  # that leaves out enough
            highest = depth_step = None
        elif isinstance(highest, str):  # of A-lines that are still to come
            highest = None
        return ReconstructionSetup(
            replace(geometry, samples=self.samples(geometry.samples), dt=interval),
            replace(grid, modes=self.modes, depth=depth, depth_step=depth_step, upsampling=1),
            replace(method, max_frequency=highest),
            compute,
        )

    def samples(self, samples: int) -> int:
        """Return the number of samples of an A-line after decimation."""
        return ceil(samples / self.decimation)

    def decimate(self, traces: NDArray[Any]) -> NDArray[np.float32]:
        """Decimate A-lines by ``decimation`` after a low-pass filter at the new Nyquist frequency.

        Parameters
        ----------
        traces
            (K, N_t); the first sample of the result is at the time of the first one here.

        Returns
        -------
        ndarray
            (K, ceil(N_t/decimation)) float32.
        """
        from scipy import fft

        if self.decimation == 1:
            return traces.astype(np.float32, copy=False)
        count = self.samples(traces.shape[1])
        long = 2 * count * self.decimation  # zeros after the record: its end does not ring into its beginning
        spectrum = fft.rfft(traces.astype(np.float32, copy=False), long, axis=1)[:, : count + 1]
        edge = np.clip((1 - np.arange(count + 1) / count) / 0.1, 0, 1)
        spectrum *= (np.sin(np.pi / 2 * edge) ** 2 / self.decimation).astype(np.float32)
        return np.ascontiguousarray(fft.irfft(spectrum, 2 * count, axis=1)[:, :count], np.float32)


def choose_preview(modes: int, samples: int, spacing: float, depth_step: float) -> CoarseParameters:
    """Choose coarse parameters with at most a quarter of the full image's voxels.

    Parameters
    ----------
    modes, samples
        Lateral modes an axis and samples of an A-line, of the full image.
    spacing, depth_step
        Its voxel's sides in metres, before upsampling.
    """
    for coarser in MAX_RATIO:
        decimation = max(1, min(int(DEPTH_TO_LATERAL * coarser * spacing / depth_step), samples // 16))
        if coarser**2 * decimation >= 1 / MAX_VOXELS:
            break
    return CoarseParameters(max(2, round(modes / coarser)), decimation)
