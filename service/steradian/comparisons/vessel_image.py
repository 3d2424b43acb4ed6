"""Expected image of one vessel through a mask: contrast, width as measured, and resolution.

The direct method is linear: the image of a noisy scan is that of the vessel plus an image of noise, which scales with
the noise's standard deviation. One noise-free image and a few images of noise give the readings of many noisy scans.
The iterative method is not linear, so each of its noisy scans is reconstructed, over the whole depth of the record as
of a scan: its widths depend on the depth range.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.core.progress import CancelCheck
from steradian.imaging import Acquisition, Compute, ImageGrid, Iterative, Nufft, Volume, reconstruct
from steradian.masks import Mask
from steradian.masks.metrics import nearest_neighbour_spacing
from steradian.phantoms.vessel_alines import vessel_alines
from steradian.quality import peak_to_background
from steradian.quality.profiles import profile
from steradian.quality.pulse_noise import PulseNoise
from steradian.quality.width import find_width

ImagingMethod = Literal["direct", "iterative"]
VOXEL = 60e-6
LEAST_UNIT = 150e-6
"""Surroundings are counted in diameters of the vessel, or in this many metres of a thinner one."""
RING = (3.0, 10.0)
"""Nearest and farthest distance of the surroundings from the vessel's axis."""
PLACES = 6
"""Places of the vessel near the wanted one, and images of noise, for the direct method."""
GOLDEN = 0.6180339887
SLAB = 0.5e-3
"""Half length in metres of the vessel's part whose contrast is read."""
NOISE_REACH = 0.5e-3
"""Sections of an image of noise up to this distance in metres from the vessel's middle count as different noise."""
NOISY_SCANS = 3
"""Simulated scans for the iterative method."""
MAX_CONTRAST_DB = 40.0
"""Contrast above which an iterative image's surroundings count as empty: most of their voxels are 0."""
DEFAULT_SAMPLES = 1024
LEAST_HALF_LENGTH = 3.5e-3
"""Least distance in metres from the vessel's middle to its ends, where the aperture is wide enough."""
_CPU = Compute(device="cpu")


@dataclass(frozen=True)
class Reading:
    """Contrast and width of a vessel in an image.

    Attributes
    ----------
    contrast_db
        Peak of the vessel's middle millimetre over the root mean square 3 to 10 diameters beside it, 20·log₁₀. In
        single sections, without noise, it varies by several decibels with the place.
    width
        Full width at half maximum in metres of the profile through the vessel's middle along x
        (:func:`steradian.quality.width`); nan where it does not fall to a half on both sides.
    """

    contrast_db: float
    width: float


@dataclass(frozen=True)
class ExpectedReading:
    """Medians and scatter of the readings of simulated scans that differ in their noise and the vessel's exact place.

    Attributes
    ----------
    contrast_db, width
        Medians of :class:`Reading`.
    width_scatter
        Standard deviation of the width over its median, from the 16th and 84th percentile; infinite where fewer
        than four of five readings have a width.
    side_lobes_db
        Contrast without noise; of the iterative method nan.
    resolution
        Width of the image of a thin line at the same place, in metres.
    """

    contrast_db: float
    width: float
    width_scatter: float
    side_lobes_db: float
    resolution: float


@dataclass(frozen=True)
class VesselImage:
    """Simulated images of a straight uniform vessel along y through a mask, in an ideal sensor's A-lines.

    Parameters
    ----------
    mask
        A mask of a plane.
    place
        x, y, z of the vessel's middle in metres.
    diameter
        In metres.
    noise
        Of one pulse: the peak of the A-line straight above the vessel over the noise.
    averages
        Pulses averaged into an A-line.
    sampling_interval, sound_speed
        Seconds and metres per second.
    modes
        Voxels on each lateral axis; ``None``: of 60 µm.
    """

    mask: Mask
    place: tuple[float, float, float]
    diameter: float
    noise: PulseNoise
    averages: int
    sampling_interval: float = 8e-9
    sound_speed: float = 1500.0
    modes: int | None = None

    @property
    def unit(self) -> float:
        """Length in metres that distances to the surroundings are counted in."""
        return max(self.diameter, LEAST_UNIT)

    @property
    def samples(self) -> int:
        """Samples of an A-line (:func:`needed_samples`)."""
        return needed_samples(self.mask, self.place, self.unit, self.sampling_interval * self.sound_speed)

    @cached_property
    def reference(self) -> float:
        """Peak of the A-line straight above the vessel."""
        return float(np.abs(self._pressure(self.diameter, np.array([self.place[:2]]))).max())

    @property
    def sigma(self) -> float:
        """Standard deviation of the noise of an averaged A-line, in the unit of the A-lines."""
        return float(self.reference * 10 ** (-self.noise.decibels / 20) / np.sqrt(self.averages))

    def expect(self, method: ImagingMethod, *, cancelled: CancelCheck | None = None) -> ExpectedReading:
        """Return the expected readings.

        Raises
        ------
        Cancelled
            When ``cancelled`` said so.
        """
        line = self._alines(thin=True)
        line *= np.float32(self.reference / np.abs(line).max())
        if method == "direct":
            return self._expect_direct(line, cancelled)
        readings = []
        for seed, near in enumerate(self._near_places(NOISY_SCANS)):
            noisy = near._alines() + near.draw_noise(seed)
            readings.append(near.read(near._reconstruct(noisy, method, cancelled)))
        thin = self._reconstruct(line + self.draw_noise(NOISY_SCANS), method, cancelled)
        contrasts = [min(each.contrast_db, MAX_CONTRAST_DB) for each in readings]
        return _summary(contrasts, [each.width for each in readings], float("nan"), self.read_width(thin))

    def draw_noise(self, seed: int) -> NDArray[np.float32]:
        """Return noise (M, N_t) of averaged A-lines."""
        return np.float32(self.sigma) * self.noise.draw((self.mask.count, self.samples), seed)

    def read(self, volume: Volume) -> Reading:
        """Return contrast and width of the vessel in an image."""
        return Reading(self.read_contrast(volume), self.read_width(volume))

    def read_contrast(self, volume: Volume) -> float:
        """Return the vessel's contrast in an image in dB."""
        x, y, z = self.place
        slab = np.asarray(volume.values[:, np.abs(volume.coordinates("y") - y) <= SLAB], np.float64)
        distance = np.hypot(volume.coordinates("x")[:, None] - x, volume.coordinates("z") - z)
        inside = distance <= 1.01 * max(self.diameter / 2, max(volume.spacing))
        surroundings = (distance > RING[0] * self.unit) & (distance < RING[1] * self.unit)
        if not surroundings.any():
            raise InvalidInput("vessel", self.diameter, "less (m), so that the image has surroundings of the vessel")
        ratio = peak_to_background(slab, *(_repeated(each, slab.shape) for each in (inside, surroundings)))
        return float(20 * np.log10(ratio)) if ratio > 0 else float("-inf")

    def read_width(self, volume: Volume) -> float:
        """Return the vessel's width in an image in metres; nan where it has none."""
        x, y, z = self.place
        reach = RING[1] * self.unit
        found = find_width(*profile(volume, (x - reach, y, z), (x + reach, y, z)))
        return float("nan") if found is None else found.fwhm

    def _expect_direct(self, line: NDArray[np.float32], cancelled: CancelCheck | None) -> ExpectedReading:
        contrasts, widths, without = [], [], []
        for seed, near in enumerate(self._near_places(PLACES)):
            image = near._reconstruct(near._alines(), "direct", cancelled)
            noise = near._reconstruct(near.draw_noise(seed), "direct", cancelled)
            without.append(near.read_contrast(image))
            contrasts.append(near.read_contrast(replace(image, values=image.values + noise.values)))
            widths += [near.read_width(noisy) for noisy in near._noisy_sections(image, noise)]
        thin = self._reconstruct(line, "direct", cancelled)
        return _summary(contrasts, widths, float(np.median(without)), self.read_width(thin))

    def _near_places(self, count: int) -> list[VesselImage]:
        """Return copies with the vessel at ``count`` places within half a sensor spacing, the voxels' at least."""
        gaps = nearest_neighbour_spacing(self.mask)
        beside = np.linalg.norm(self.mask.film_positions - np.array(self.place[:2]), axis=1)
        gap = max(VOXEL, float(np.median(gaps[np.argsort(beside)[:9]])))
        shares = [((place + 0.5) * np.array([1 / count, GOLDEN, GOLDEN**2])) % 1 - 0.5 for place in range(count)]
        reach = np.array([gap, gap, VOXEL])
        return [replace(self, place=_moved(self.place, share * reach)) for share in shares]

    def _noisy_sections(self, image: Volume, noise: Volume) -> Iterator[Volume]:
        """Return the image around its section with noise from different places along the vessel."""
        row, spacing = self._row(image, self.place[1]), image.spacing[1]
        first, last = max(0, row - 2), min(image.values.shape[1], row + 3)
        assert image.axes.y is not None  # noqa: S101 - a volume
        axes = replace(image.axes, y=image.axes.y[first:last])
        reach = round(NOISE_REACH / spacing)
        for offset in range(-reach, reach + 1, 2):
            if first + offset >= 0 and last + offset <= image.values.shape[1]:
                there = noise.values[:, first + offset : last + offset]
                yield replace(image, values=image.values[:, first:last] + there, axes=axes)

    def _row(self, volume: Volume, y: float) -> int:
        return int(np.abs(volume.coordinates("y") - y).argmin())

    def _alines(self, *, thin: bool = False) -> NDArray[np.float32]:
        return self._pressure(0.0 if thin else self.diameter, self.mask.positions)

    def _pressure(self, diameter: float, positions: NDArray[np.float64]) -> NDArray[np.float32]:
        x, y, z = self.place
        beside = self.mask.aperture / 2 - abs(y)
        half = min(max(6 * self.diameter, z, LEAST_HALF_LENGTH), max(beside, 6 * self.diameter))
        return vessel_alines(
            diameter,
            (x, y, z),
            half,
            positions,
            samples=self.samples,
            sampling_interval=self.sampling_interval,
            sound_speed=self.sound_speed,
        )

    def _reconstruct(self, traces: NDArray[np.float32], method: ImagingMethod, cancelled: CancelCheck | None) -> Volume:
        if cancelled and cancelled():
            raise Cancelled("the design was stopped")
        mask, reach = self.mask, RING[1] * self.unit
        acquisition = Acquisition(
            traces,
            mask.positions,
            dt=self.sampling_interval,
            sound_speed=self.sound_speed,
            aperture=mask.aperture,
            weights=mask.weights,
        )
        modes = self.modes or max(2, round(mask.aperture / VOXEL))
        near = (max(0.0, self.place[2] - reach), self.place[2] + reach)
        if method == "direct":
            return reconstruct(acquisition, ImageGrid(modes, depth=near), Nufft(), compute=_CPU, cancelled=cancelled)
        return reconstruct(acquisition, ImageGrid(modes), Iterative(), compute=_CPU, cancelled=cancelled)


def needed_samples(mask: Mask, place: tuple[float, float, float], unit: float, step: float) -> int:
    """Return the samples, ``step`` metres apart, of an A-line: 1024, or as many as sound from near the vessel needs."""
    across = np.abs(mask.film_positions - np.array(place[:2])).max(axis=0)
    farthest = max(float(np.hypot(np.linalg.norm(across), place[2])) + 2 * unit, place[2] + RING[1] * unit)
    return max(DEFAULT_SAMPLES, 64 * ceil(farthest / step / 64 + 1 / 64))


def _moved(place: tuple[float, float, float], offset: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = place
    return x + float(offset[0]), y + float(offset[1]), z + float(offset[2])


def _repeated(section: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    return np.broadcast_to(section[:, None], shape)


def _summary(contrasts: list[float], widths: list[float], side_lobes: float, resolution: float) -> ExpectedReading:
    width = np.array(widths)
    seen = width[np.isfinite(width)]
    scatter = float("inf")
    middle = float(np.median(seen)) if len(seen) else float("nan")
    if len(seen) >= 0.8 * len(width):
        low, high = np.percentile(seen, [16, 84])
        scatter = float(high - low) / 2 / middle
    return ExpectedReading(
        contrast_db=float(np.median(contrasts)),
        width=middle,
        width_scatter=scatter,
        side_lobes_db=side_lobes,
        resolution=resolution,
    )
