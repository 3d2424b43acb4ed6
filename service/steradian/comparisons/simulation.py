"""Simulated scan and reconstruction of a phantom through a mask."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import ceil
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import (
    Acquisition,
    AcquisitionGeometry,
    Compute,
    ImageGrid,
    Iterative,
    Nufft,
    Volume,
    reconstruct,
)
from steradian.masks import Mask
from steradian.phantoms import Balls, add_noise, pressure, rasterise
from steradian.quality import correlation, disc

Method = Literal["direct", "iterative"]
METHODS: tuple[Method, ...] = ("direct", "iterative")
VOXEL = 60e-6
CPU = Compute(device="cpu")
MARGIN = 3.0
"""Depths are reconstructed so many s beyond the object's outermost balls."""


@dataclass(frozen=True)
class Correlation:
    """Similarity of an image to the true object: Pearson correlation over all voxels (pixels) of a region.

    Attributes
    ----------
    around, field
        Of the volumes: within the cylinder around the point of interest, and everywhere.
    around_mip, field_mip
        Of the projections along z.
    mip
        (Nx, Ny) that projection.
    """

    around: float
    field: float
    around_mip: float
    field_mip: float
    mip: NDArray[np.float32]


@dataclass(frozen=True)
class SimulationResult:
    """Simulated images of an object through a mask: a :class:`Correlation` by method, and the object's z-projection."""

    by: dict[Method, Correlation]
    truth_mip: NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Simulation:
    """Simulation of scans of one known object through different masks.

    Parameters
    ----------
    thing
        Balls, whose pressure has a closed form; or a volume of initial pressure, which the reconstructions' own
        forward model propagates (the images then share its errors, and look a little better than they would).
    centre
        x and y of the point of interest in metres.
    region
        Diameter in metres of the cylinder around it.
    noise
        Highest peak of all A-lines over the noise's standard deviation, in dB; ``None``: no noise.
    modes
        Voxels on each lateral axis; ``None``: of 60 µm, or the volume's own.
    sampling_interval, sound_speed
        Seconds (``None``: 16 ns, or the volume's own depth step) and metres per second.
    iterations
        Of the iterative reconstruction; 0 leaves it out.
    seed
        Of the noise.
    """

    thing: Balls | Volume
    centre: tuple[float, float]
    region: float
    noise: float | None = 30.0
    modes: int | None = None
    sampling_interval: float | None = None
    sound_speed: float = 1500.0
    iterations: int = 30
    seed: int = 0
    _truths: dict[tuple[Any, ...], Volume] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.region > 0:
            raise InvalidInput("region", self.region, "> 0 (m)")
        if self.iterations < 0:
            raise InvalidInput("iterations", self.iterations, "0 (none) or more")
        if isinstance(self.thing, Volume) and self.thing.dimensions != 3:
            raise InvalidInput("phantom", "an image [x, z]", "a volume [x, y, z]")

    @property
    def dt(self) -> float:
        """Sampling interval in seconds."""
        if isinstance(self.thing, Volume):
            return self.thing.spacing[-1] / self.sound_speed
        return self.sampling_interval or 16e-9

    @property
    def depths(self) -> tuple[float, float]:
        """First and last reconstructed depth in metres."""
        if isinstance(self.thing, Volume):
            return float(self.thing.axes.z[0]), float(self.thing.axes.z[-1])
        z, s = self.thing.centres[:, 2], self.thing.sigmas
        return max(0.0, float((z - MARGIN * s).min())), float((z + MARGIN * s).max())

    def simulate(
        self, mask: Mask, *, progress: Progress | None = None, cancelled: CancelCheck | None = None
    ) -> SimulationResult:
        """Simulate a scan of the object through a mask and reconstruct its images.

        Raises
        ------
        InvalidInput
            When the mask is a line, or a volume is not as wide as the mask's aperture.
        Cancelled
            When ``cancelled`` said so.
        """
        if mask.is_line:
            raise InvalidInput("mask", "a line of sensors", "a mask of a plane")
        modes = self._modes(mask)
        traces = self.alines(mask, progress=progress, cancelled=cancelled)
        found: dict[Method, Correlation] = {}
        for method in METHODS if self.iterations else METHODS[:1]:
            if cancelled and cancelled():
                raise Cancelled("the comparison was stopped")
            acquisition = Acquisition(
                traces,
                mask.positions,
                dt=self.dt,
                sound_speed=self.sound_speed,
                aperture=mask.aperture,
                weights=mask.weights,
            )
            chosen = Iterative(iterations=self.iterations) if method == "iterative" else Nufft()
            image = reconstruct(
                acquisition,
                ImageGrid(modes, depth=self.depths),
                chosen,
                compute=CPU,
                progress=_named(progress, method),
                cancelled=cancelled,
            )
            truth = self.truth(image)
            found[method] = self._judge(image, truth)
        return SimulationResult(found, truth.mip("z"))

    def truth(self, like: Volume) -> Volume:
        """Return the true initial pressure of the object at the voxels of an image."""
        if isinstance(self.thing, Volume):
            return self.thing
        corner = tuple(float(like.coordinates(name)[0]) for name in like.names)
        voxels = (like.values.shape, like.spacing, corner)
        if voxels not in self._truths:
            self._truths[voxels] = rasterise(self.thing, like)
        return self._truths[voxels]

    def _modes(self, mask: Mask) -> int:
        if not isinstance(self.thing, Volume):
            return self.modes or round(mask.aperture / VOXEL)
        nx, ny, _ = self.thing.values.shape
        wide = nx * self.thing.spacing[0]
        if nx != ny or abs(wide / mask.aperture - 1) > 1e-6:
            raise InvalidInput(
                "phantom",
                f"a volume of {nx} × {ny} voxels, {wide:.4g} m",
                f"square, of the aperture {mask.aperture:g} m",
            )
        return int(nx)

    def alines(
        self, mask: Mask, *, progress: Progress | None = None, cancelled: CancelCheck | None = None
    ) -> NDArray[np.float32]:
        """Return the simulated A-lines (M, N_t) of the object at a mask's points, with noise."""
        corner = mask.aperture / 2 + float(np.abs(mask.positions).max())
        samples = ceil(np.hypot(np.sqrt(2) * corner, self.depths[1]) / self.sound_speed / self.dt) + 1
        if isinstance(self.thing, Volume):
            from steradian.imaging.operators import ForwardOperator

            geometry = AcquisitionGeometry(
                mask.positions, samples, dt=self.dt, sound_speed=self.sound_speed, aperture=mask.aperture
            )
            model = ForwardOperator(
                geometry, ImageGrid(self._modes(mask), depth=self.depths, lateral_padding=2.0), compute=CPU
            )
            clean = np.asarray(model.forward(np.asarray(self.thing.values, np.float32), cancelled=cancelled))
        else:
            clean = pressure(
                self.thing,
                mask.positions,
                samples=samples,
                sampling_interval=self.dt,
                sound_speed=self.sound_speed,
                progress=progress,
                cancelled=cancelled,
            )
        return clean if self.noise is None else add_noise(clean, self.noise, seed=self.seed)

    def _judge(self, image: Volume, truth: Volume) -> Correlation:
        near = disc(image.coordinates("x"), image.coordinates("y"), self.region, self.centre)
        mip, wanted = image.mip("z"), truth.mip("z")
        cylinder = np.broadcast_to(near[..., None], image.values.shape)
        return Correlation(
            around=correlation(image.values, truth.values, cylinder),
            field=correlation(image.values, truth.values),
            around_mip=correlation(mip, wanted, near),
            field_mip=correlation(mip, wanted),
            mip=np.asarray(mip, np.float32),
        )


def _named(progress: Progress | None, method: str) -> Progress | None:
    """Return a progress callback that prefixes stages with the reconstruction method's name."""
    if progress is None:
        return None
    report: Callable[[str, int, int], None] = progress
    return lambda stage, done, total: report(f"{method}: {stage}", done, total)
