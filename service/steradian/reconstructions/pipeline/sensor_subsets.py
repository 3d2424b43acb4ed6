"""Standard errors and suppression of artefacts of direct images, from images of subsets of the sensors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import Acquisition, DirectMethod, Volume, uncertainty
from steradian.imaging.artefact_suppression import suppress_artefacts
from steradian.imaging.half_images import MIN_SENSORS
from steradian.reconstructions.pipeline.resolve import ReconstructionSetup, request_field_names
from steradian.reconstructions.volumes.file import write_volume
from steradian.reconstructions.volumes.near_field import crop_depth
from steradian.scans.recording import Recording

REPLICATES = 8
"""Images with random signs that a standard error is estimated from."""
FILE = "uncertainty.h5"


@dataclass(frozen=True, slots=True)
class SubsetOptions:
    """Options that need images of subsets of the sensors.

    Parameters
    ----------
    uncertainty
        Also write the standard error of each voxel, as a second volume.
    suppress_artefacts
        Suppress what images of two halves of the sensors do not have in common.
    """

    uncertainty: bool = False
    suppress_artefacts: bool = False

    def check(self, recording: Recording, method: str, *, motion: bool) -> None:
        """Raise :class:`InvalidInput` if the options do not go with each other, the method or the sensors."""
        for name, wanted in (("uncertainty", self.uncertainty), ("suppress_artefacts", self.suppress_artefacts)):
            if not wanted:
                continue
            if method == "iterative":
                raise InvalidInput(name, "true", "a direct method; iterative images are not linear in the A-lines")
            if motion:
                raise InvalidInput(name, "true", "without motion")
            positions = np.asarray(recording.positions)
            is_line = positions.ndim == 1 or positions.shape[1] == 1
            if len(positions) < MIN_SENSORS or (is_line and name == "suppress_artefacts"):
                where = " in a plane" if name == "suppress_artefacts" else ""
                raise InvalidInput(name, "true", f"{MIN_SENSORS} or more sensors{where}")
        if self.uncertainty and self.suppress_artefacts:
            allowed = "without suppress_artefacts, which makes the image not linear in the A-lines"
            raise InvalidInput("uncertainty", "true", allowed)


NONE = SubsetOptions()


@dataclass
class UncertaintyReport:
    """Standard errors of an image, as written to ``report.json``.

    Parameters
    ----------
    file
        Volume file with the standard errors.
    replicates
        Images with random signs that they were estimated from.
    median
        Median from the depth on at which pictures begin, in the image's unit.
    above_three
        Share of these voxels whose value exceeds three standard errors.
    """

    file: str
    replicates: int
    median: float
    above_three: float


def suppressed_image(
    recording: Recording, acquisition: Acquisition, setup: ReconstructionSetup, *, cancelled: CancelCheck | None = None
) -> Volume:
    """Return the direct image with suppressed artefacts; its notes say so."""
    assert isinstance(setup.method, DirectMethod)  # noqa: S101 - checked before
    with request_field_names():
        return suppress_artefacts(
            acquisition,
            setup.grid,
            setup.method,
            outline=recording.outline,
            compute=setup.compute,
            cancelled=cancelled,
        )


def standard_errors(
    acquisition: Acquisition,
    setup: ReconstructionSetup,
    *,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Volume:
    """Return the standard error of each voxel of the direct image."""
    assert isinstance(setup.method, DirectMethod)  # noqa: S101 - checked before
    with request_field_names():
        return uncertainty(
            acquisition,
            setup.grid,
            setup.method,
            replicates=REPLICATES,
            compute=setup.compute,
            progress=progress,
            cancelled=cancelled,
        )


def write_uncertainty(
    folder: Path, image: Volume, errors: Volume, recording: Recording, parameters: dict[str, object], near_field: float
) -> UncertaintyReport:
    """Write the standard errors of an image as ``uncertainty.h5`` into a folder; return their report."""
    write_volume(
        folder / FILE,
        errors,
        parameters=parameters,
        provenance={**recording.provenance, "values": f"standard errors, of {REPLICATES} images with random signs"},
        near_field=near_field,
        centre=recording.centre,
    )
    shown, below = (crop_depth(volume, near_field).values for volume in (image, errors))
    return UncertaintyReport(FILE, REPLICATES, float(np.median(below)), float(np.mean(shown > 3 * below)))
