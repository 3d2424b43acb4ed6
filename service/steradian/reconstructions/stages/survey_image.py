"""Coarse image of a survey, and proposals of points of interest for the next stage of the scan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck
from steradian.imaging import Acquisition, DirectMethod, Volume
from steradian.imaging.geometry.sensor_areas import sensed_region
from steradian.imaging.half_images import MIN_SENSORS, half_images
from steradian.quality.points_of_interest import (
    LEAST_SIGNAL_TO_NOISE,
    Choice,
    FoundPoint,
    find_points_of_interest,
    mean_image,
)
from steradian.reconstructions.live.preview import CoarseParameters
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.resolve import preprocess, resolve_setup
from steradian.reconstructions.shot_normalisation import normalise_shots
from steradian.scans.opening import FIRST, open_recording

SPACING = 120e-6
"""Lateral side of a voxel in metres: blobs are smoothed to several times that."""
DEPTH_STEP = 50e-6
"""Greatest depth step in metres."""


@dataclass(frozen=True)
class SurveyImage:
    """Coarse direct image of a survey.

    Attributes
    ----------
    volume
        Mean of the two halves.
    halves
        Images of every other sensor and of the others.
    """

    volume: Volume
    halves: tuple[Volume, Volume]


def find_in_scan(
    path: Path,
    *,
    choice: Choice = "brightest",
    count: int = 1,
    least_signal_to_noise: float = LEAST_SIGNAL_TO_NOISE,
    depth: tuple[float, float] | None = None,
    parameters: ReconstructionParameters | None = None,
    cancelled: CancelCheck | None = None,
) -> list[FoundPoint]:
    """Find points of interest in the image of the A-lines stored in a scan file.

    Parameters
    ----------
    path
        The scan file; another process may be writing to it.
    choice, count, least_signal_to_noise, depth
        As of :func:`~steradian.quality.points_of_interest.find_points_of_interest`.
    parameters
        Speed of sound, medium, conditioning and treatment of shots; the voxels and the method are the survey's own.
    cancelled
        Asked between pieces of work.

    Returns
    -------
    list of FoundPoint
        Empty where nothing stands out of the noise.

    Raises
    ------
    NotFound, DamagedFile
        When the file cannot be read or holds no A-line.
    InvalidInput
        When there are fewer than 16 A-lines, the sensors are on a line, or a parameter is out of range.
    Cancelled
        When ``cancelled`` returned ``True``.
    """
    survey = survey_image(path, parameters=parameters, cancelled=cancelled)
    return find_points_of_interest(
        survey.volume,
        choice=choice,
        count=count,
        least_signal_to_noise=least_signal_to_noise,
        depth=depth,
        halves=survey.halves,
    )


def survey_image(
    path: Path, *, parameters: ReconstructionParameters | None = None, cancelled: CancelCheck | None = None
) -> SurveyImage:
    """Reconstruct the A-lines stored in a scan file directly, in voxels of 120 µm; as :func:`find_in_scan`."""
    chosen = parameters or ReconstructionParameters()
    recording, _ = normalise_shots(open_recording(path, FIRST), chosen.shots, cancelled=cancelled)
    if recording.positions.shape[1] != 2:
        raise InvalidInput("scan", "sensors on a line", "sensors in a plane")
    if len(recording.positions) < MIN_SENSORS:
        raise InvalidInput("scan", f"{len(recording.positions)} A-lines", f"{MIN_SENSORS} or more")
    modes = max(2, round(recording.aperture / SPACING))
    direct = chosen.replace(method="nedner", modes=modes, weights="voronoi", upsampling=1, depth_range=None)
    setup = resolve_setup(recording, direct)
    step = setup.geometry.dt * setup.geometry.sound_speed
    coarse = CoarseParameters(modes, max(1, int(DEPTH_STEP / step)))
    traces = coarse.decimate(preprocess(recording, direct))
    geometry, grid, method, compute = coarse.apply(setup)
    assert isinstance(method, DirectMethod)  # noqa: S101 - of the method nedner
    outline = sensed_region(recording.positions, recording.aperture) if recording.outline is None else recording.outline
    acquisition = Acquisition(
        traces,
        recording.positions,
        dt=geometry.dt,
        medium=geometry.medium,
        t0=geometry.t0,
        aperture=recording.aperture,
    )
    cpu = replace(compute, device="cpu")
    halves = half_images(acquisition, outline, grid, method, compute=cpu, cancelled=cancelled)
    return SurveyImage(mean_image(halves), halves)
