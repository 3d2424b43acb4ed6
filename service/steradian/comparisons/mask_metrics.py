"""Metrics of one mask for the comparison."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, log10, pi

from steradian.masks import Mask
from steradian.masks.metrics import evaluate_mask
from steradian.masks.point_spread import PointSpread, point_spread
from steradian.plans import ScanPlan, VisitOrder, preview

Point = tuple[float, float, float]


@dataclass(frozen=True)
class MaskMetricsRow:
    """Metrics of one mask: a row of the comparison.

    Attributes
    ----------
    points
        Number of sensors.
    finest_m, coarsest_m
        Least and greatest distance of a sensor to its nearest neighbour.
    solid_angle_spread
        Standard deviation over mean of the sensors' solid angles seen from the point of interest, within the rim: the
        :attr:`steradian.masks.metrics.MaskMetrics.evenness`. None where the rim cuts all cells but one.
    view
        Share of the half space above the film that the sensed area fills, seen from there: of edges, how many show.
    steepest_deg
        Tilt of the steepest edges that some sensor sees.
    lateral_m, axial_m, true_m
        Full widths at half maximum of the image of a small ball at the point of interest, and of the ball itself.
    amplitude
        Peak of that image over the ball's own.
    contrast_db
        That peak over the root mean square of what surrounds it, 20·log₁₀, with noise.
    travel_m, seconds
        Way of the beam in the shortest order, and time of the scan.
    """

    points: int
    finest_m: float
    coarsest_m: float
    solid_angle_spread: float | None
    view: float
    steepest_deg: float
    lateral_m: float
    axial_m: float
    true_m: float
    amplitude: float
    contrast_db: float
    travel_m: float
    seconds: float


def evaluate(
    mask: Mask, point: Point, *, pulse_rate: float = 50.0, noise: float = 30.0
) -> tuple[MaskMetricsRow, PointSpread]:
    """Compute the metrics of a mask for the comparison.

    Parameters
    ----------
    mask
        A mask of a plane.
    point
        Point of interest x, y, z in metres, whatever the mask was made for.
    pulse_rate
        Of the laser in Hz.
    noise
        Peak of the ball's strongest A-line over the noise's standard deviation, in dB.

    Returns
    -------
    tuple
        The figures, and the image of the ball.

    Raises
    ------
    InvalidInput
        When the point is not above the film, or a figure is out of range.
    """
    seen = evaluate_mask(mask, point)
    angles = seen.solid_angles
    assert angles is not None  # noqa: S101 - there is a point of interest
    assert seen.opening_angle is not None  # noqa: S101
    spread = point_spread(mask, point, noise=noise)
    cost = preview(ScanPlan.create(mask=mask, pulse_rate=pulse_rate, order=VisitOrder.SHORTEST))
    return MaskMetricsRow(
        points=mask.count,
        finest_m=seen.finest,
        coarsest_m=seen.coarsest,
        solid_angle_spread=seen.evenness,
        view=float(angles.sum()) / (2 * pi),
        steepest_deg=degrees(seen.opening_angle) / 2,
        lateral_m=spread.lateral,
        axial_m=spread.axial,
        true_m=spread.true_width,
        amplitude=spread.peak,
        contrast_db=20 * log10(1 / spread.background) if spread.background else float("inf"),
        travel_m=cost.travel,
        seconds=cost.total_seconds,
    ), spread
