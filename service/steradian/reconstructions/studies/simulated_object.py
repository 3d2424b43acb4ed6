"""Simulation of an object at a place of an image, with the sensors and reconstruction parameters of the scan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fabry_perot.simulator.phantoms import Balls
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import Volume
from steradian.imaging.signal.bandwidth import signal_band
from steradian.imaging.signal.conditioning import Conditioning
from steradian.phantoms.spheres_and_cylinders import cylinder, gaussian_cylinder, gaussian_sphere, sphere
from steradian.quality.profiles import Profile, profile
from steradian.quality.width import Width
from steradian.reconstructions.film_response_choice import Film
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.resolve import extent_of, sound_speed_of
from steradian.reconstructions.pipeline.run import reconstruct_in_memory
from steradian.reconstructions.shot_normalisation import ShotTreatment, normalise_shots
from steradian.reconstructions.studies.orientation import direction_at
from steradian.scans.recording import Recording

Array = NDArray[np.float64]
Edge: TypeAlias = Literal["uniform", "Gaussian"]
EDGES: tuple[Edge, ...] = ("uniform", "Gaussian")
"""Profiles of initial pressure across the object; the width of either is its full width at half maximum."""
_HALF_LENGTH = 6.0, 1.5e-3
"""Half length of a cylinder: widths, and metres at least."""
_AROUND = 8.0
"""Depth reconstructed to either side of the line, in widths."""
_EXPECTED = 14
"""Images that a correction takes, about."""


@dataclass
class Steps:
    """Progress counter of a width correction; each simulated image is one step."""

    progress: Progress | None = None
    cancelled: CancelCheck | None = None
    done: int = 0

    def next(self) -> None:
        """Report one step to the progress callback."""
        if self.progress is not None:
            self.progress("simulating", self.done, max(_EXPECTED, self.done + 1))
        self.done += 1


@dataclass(frozen=True)
class SimulatedObject:
    """Simulated sphere or cylinder at the measured place, with the sensors, noise and parameters of the scan.

    Attributes
    ----------
    recording, parameters
        The scan, and how its image was made, limited to the depths around the place; the film counts as corrected.
    measured
        The same with the film and what is done to the A-lines before.
    line
        Start and end of the measured profile, x, y, z in m.
    place, direction
        Centre (x, y, z) in m; direction (3,) of a cylinder, ``None``: a sphere.
    half_length
        Of a cylinder, in m.
    noise
        Standard deviation of a sample's noise, in the recording's unit; 0 for methods that are linear, whose image of
        an object is the same with noise.
    step
        Distance in m that sound travels between two samples.
    """

    recording: Recording
    parameters: ReconstructionParameters
    measured: ReconstructionParameters
    line: tuple[Array, Array]
    place: Array
    direction: Array | None
    half_length: float
    noise: float
    step: float

    @classmethod
    def sampled_along(
        cls,
        volume: Volume,
        recording: Recording,
        parameters: ReconstructionParameters,
        line: tuple[Array, Array],
        measured: Width,
    ) -> SimulatedObject:
        """Create the simulated object for comparison with a profile measured along a line."""
        recording, _ = normalise_shots(recording, parameters.shots)
        along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
        place = line[0] + measured.centre * along
        around = _AROUND * measured.fwhm
        speed = sound_speed_of(recording, parameters)
        step = speed * recording.sampling_interval
        deepest = (extent_of(recording, parameters).end - 1) * step
        ends = (float(line[0][2]), float(line[1][2]))
        depths = (max(0.0, min(ends) - around), min(deepest, max(ends) + around))
        own = parameters.model_copy(
            update={"depth_range": depths, "sound_speed": speed, "shots": ShotTreatment()},
        )
        local = own.model_copy(
            update={
                "film": Film(),
                "conditioning": Conditioning(band=parameters.conditioning.band, delay=parameters.conditioning.delay),
            }
        )
        direction = direction_at(volume, place, measured.fwhm)
        noise = 0.0
        if parameters.method == "iterative":
            noise = signal_band(np.asarray(recording.traces), recording.sampling_interval)[1]
            noise *= float(np.mean(np.abs(recording.scale)))
        half_length = max(_HALF_LENGTH[0] * measured.fwhm, _HALF_LENGTH[1])
        return cls(recording, local, own, line, place, direction, half_length, noise, step)

    @property
    def shape(self) -> str:
        """Name of the shape: sphere or cylinder."""
        return "sphere" if self.direction is None else "cylinder"

    def direct(self) -> SimulatedObject | None:
        """Return a copy that is reconstructed by the direct method; ``None`` if the method is already direct."""
        if self.parameters.method != "iterative":
            return None
        one, other = (each.model_copy(update={"method": "nedner"}) for each in (self.parameters, self.measured))
        return replace(self, parameters=one, measured=other, noise=0.0)

    def measured_profile(self, steps: Steps) -> Profile:
        """Return the profile along the line in an image reconstructed from the scan's own A-lines."""
        steps.next()
        return profile(reconstruct_in_memory(self.recording, self.measured, cancelled=steps.cancelled), *self.line)

    def image(self, edge: Edge, diameter: float, amplitude: float, steps: Steps) -> Profile:
        """Return the profile along the line in the image of a simulated object of given diameter (m) and pressure."""
        from steradian.phantoms.forward import pressure

        steps.next()
        recording = self.recording
        traces = amplitude * pressure(
            self._balls(edge, diameter),
            recording.positions,
            samples=recording.traces.shape[1],
            sampling_interval=recording.sampling_interval,
            sound_speed=float(self.parameters.sound_speed or 0),
            time_zero=recording.time_zero + self.parameters.conditioning.delay,
            cancelled=steps.cancelled,
        )
        if self.noise:
            random = np.random.default_rng(0).standard_normal(traces.shape, dtype=np.float32)
            traces = traces + np.float32(self.noise) * random
        made = replace(recording, traces=traces, scale=1.0, shots=None)
        return profile(reconstruct_in_memory(made, self.parameters, cancelled=steps.cancelled), *self.line)

    def _balls(self, edge: Edge, diameter: float) -> Balls:
        if self.direction is None:
            return (sphere if edge == "uniform" else gaussian_sphere)(diameter, self.place, self.step)
        make = cylinder if edge == "uniform" else gaussian_cylinder
        return make(diameter, self.place, self.direction, self.half_length, self.step)
