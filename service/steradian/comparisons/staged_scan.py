"""Scan in stages as a candidate of the mask comparison: a survey, then a focus on the brightest place found."""

from __future__ import annotations

from dataclasses import dataclass

from steradian.comparisons.simulation import CPU, Simulation
from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck
from steradian.imaging import Acquisition, ImageGrid, Nufft
from steradian.imaging.half_images import half_images
from steradian.masks import Mask
from steradian.masks.staged import MIN_FURTHER_POINTS, extend_mask, survey_mask
from steradian.masks.weights import resolve_outline
from steradian.quality.points_of_interest import FoundPoint, find_points_of_interest, mean_image

SURVEY_VOXEL = 120e-6
"""Lateral side in metres of the voxels of a survey's image."""
MIN_SURVEY = 16


@dataclass(frozen=True)
class StagedScan:
    """Scan in two stages: evenly spread points, then points focused on the brightest place that these show.

    Parameters
    ----------
    aperture
        Side X of the square aperture in metres.
    count
        Number of points of both stages.
    survey
        Number of points of the first stage; ``None``: an eighth, but at least 120 and at most half of all.
    seed
        Seed of the points.
    """

    aperture: float
    count: int
    survey: int | None = None
    seed: int = 0

    @property
    def survey_count(self) -> int:
        """Number of points of the survey; raises ``InvalidInput`` if no number fits."""
        count = min(max(120, self.count // 8), self.count // 2) if self.survey is None else self.survey
        if not MIN_SURVEY <= count <= self.count - MIN_FURTHER_POINTS:
            raise InvalidInput("survey", count, f"{MIN_SURVEY} to {self.count - MIN_FURTHER_POINTS} (points)")
        return count

    def build(self, simulation: Simulation, *, cancelled: CancelCheck | None = None) -> tuple[Mask, FoundPoint | None]:
        """Simulate the survey with noise, and return the mask of both stages and the found point of interest.

        Where the survey shows nothing, all points are evenly spread and there is no point of interest.
        """
        survey = survey_mask(self.aperture, self.survey_count, seed=self.seed)
        found = find_in_survey(simulation, survey, cancelled=cancelled)
        if found is None:
            return survey_mask(self.aperture, self.count, seed=self.seed), None
        return extend_mask(survey, [found.position], self.count - survey.count, seed=self.seed), found


def find_in_survey(simulation: Simulation, survey: Mask, *, cancelled: CancelCheck | None = None) -> FoundPoint | None:
    """Return the brightest point of interest in the image of a simulated survey; ``None`` if nothing stands out."""
    acquisition = Acquisition(
        simulation.alines(survey, cancelled=cancelled),
        survey.positions,
        dt=simulation.dt,
        sound_speed=simulation.sound_speed,
        aperture=survey.aperture,
    )
    deepest = min(survey.aperture, acquisition.geometry.samples * simulation.dt * simulation.sound_speed)
    grid = ImageGrid(max(2, round(survey.aperture / SURVEY_VOXEL)), depth=(0.0, deepest))
    halves = half_images(
        acquisition, resolve_outline(survey), grid, Nufft(tolerance=1e-3), compute=CPU, cancelled=cancelled
    )
    found = find_points_of_interest(mean_image(halves), halves=halves)
    return found[0] if found else None
