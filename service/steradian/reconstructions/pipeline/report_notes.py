"""Notes on limits of an image for the reconstruction report."""

from __future__ import annotations

from collections.abc import Iterator

from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.sensor_areas import sensed_region
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.resolve import begins_at, extent_of, medium_of
from steradian.scans.recording import Recording

AREA_MISMATCH_RATIO = 0.05
"""So far from the area that the sensors cover the sum of weights must be to be noted."""


def notes_on_depth(recording: Recording, chosen: ReconstructionParameters) -> Iterator[str]:
    """Yield a note on depths seen only by distant sensors, if the A-lines begin later than the laser pulse."""
    if not extent_of(recording, chosen).late:
        return
    begins = begins_at(recording, chosen)
    depth = f"{1e3 * medium_of(recording, chosen).depth_at(begins):.4g} mm"
    shown = "" if chosen.depth_range else ", where the image begins; a first depth of 0 shows it from the film on"
    yield (
        f"A-lines begin {1e6 * begins:.4g} µs after the laser pulse: what lies less deep than {depth} is heard only by "
        f"sensors far enough to its side{shown}"
    )


def notes_on_weights(recording: Recording, total: float) -> Iterator[str]:
    """Yield a warning if the sum of the weights is not the sensed area."""
    if recording.outline is not None:
        return
    ratio = total / outlines.area(sensed_region(recording.positions, recording.aperture))
    if abs(ratio - 1) > AREA_MISMATCH_RATIO:
        yield (
            f"the weights sum to {ratio:.2f} times the area that the sensors cover, and so do amplitudes; "
            "weights voronoi gives each sensor the area of its cell"
        )
