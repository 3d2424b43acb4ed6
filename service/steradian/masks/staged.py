"""Masks of scans in stages: an even survey, extended by points that focus on places of interest.

The further points form a constrained centroidal Voronoi tessellation (Q. Du, V. Faber, M. Gunzburger, "Centroidal
Voronoi tessellations", 1999): the measured points stay, and Lloyd's iteration moves the further ones to the centroids
of their cells. Cells are sampled where the points of interest want sensors, equally many samples in equal solid
angles; the weight of a place is the square of the wanted density, for which the best points have that density.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH
from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.polygons import Outline
from steradian.masks.arrangement_base import MAX_POINTS, check_offset
from steradian.masks.equi_steradian import EquiSteradian
from steradian.masks.mask import Mask
from steradian.masks.random_masks import poisson_disc_mask
from steradian.masks.solid_angle_sampling import Density, sample_solid_angles, stratified_choice
from steradian.masks.weights import expand_outline, resolve_outline, weights_for

Array = NDArray[np.float64]
MAX_POINTS_OF_INTEREST = 8
MIN_FURTHER_POINTS = 5
ITERATIONS = 24
"""Lloyd's iterations; the image is the same within the noise from 12 on."""
MIN_SPACING_RATIO = 0.35
"""A further point closer to another than this part of the expected spacing is dropped."""


def survey_mask(
    aperture: float,
    count: int,
    *,
    depth: float | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
) -> Mask:
    """Return the mask of a survey: about ``count`` Poisson-disc points over the whole aperture.

    Parameters
    ----------
    aperture
        Side X of the square aperture in metres.
    count
        Number of points; by chance it is missed by a few at times.
    depth, offset
        Point of interest in metres for which the mask is judged, if there is one already.
    seed
        Seed of the points.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.

    Examples
    --------
    >>> survey_mask(13.56e-3, 200).arrangement["arrangement"]
    'poisson-disc'
    """
    return poisson_disc_mask(aperture, count=count, depth=depth, offset=offset, seed=seed)


def extend_mask(mask: Mask, points_of_interest: ArrayLike, count: int, *, seed: int = 0) -> Mask:
    """Return a mask extended by points that are equi-steradian around points of interest.

    Every place of the aperture is then sensed about as densely as the most demanding point of interest asks there; the
    points of ``mask`` are counted in.

    Parameters
    ----------
    mask
        Points measured already; the first points of the new mask.
    points_of_interest
        (P, 3) x, y, depth in metres; 1 to 8 points.
    count
        Number of further points, at least 5. Fewer are added where the aperture is full already.
    seed
        Seed of the further points.

    Returns
    -------
    Mask
        Weights are the areas of the Voronoi cells of all points. ``arrangement`` names the survey's arrangement, the
        number of points at which each earlier stage ended (``stage_ends``) and the points of interest, those of an
        earlier stage first.

    Raises
    ------
    InvalidInput
        When the mask is a line or of several beams, a point of interest is not over the aperture, or a number is out
        of range.

    Examples
    --------
    >>> survey = survey_mask(13.56e-3, 100)
    >>> extend_mask(survey, [(2e-3, 0.0, 3e-3)], 300).count - survey.count
    300
    """
    points = _check(mask, points_of_interest, count)
    outline = _outline(mask, points)
    further = _further_points(mask, points, count, outline, seed)
    positions = np.concatenate([mask.positions, further])
    outline = expand_outline(outline, positions)
    return Mask.create(
        aperture=mask.aperture,
        depth=float(mask.points_of_interest[0, 2] if _is_staged(mask) else points[0, 2]),
        offset=mask.offset if _is_staged(mask) else (float(points[0, 0]), float(points[0, 1])),
        positions=positions,
        weights=weights_for("voronoi", positions, outline, np.ones(len(positions))),
        outline=outline,
        arrangement=_arrangement(mask, points, seed),
    )


def _is_staged(mask: Mask) -> bool:
    return mask.arrangement.get("arrangement") == "staged"


def _check(mask: Mask, points_of_interest: ArrayLike, count: int) -> Array:
    """Return validated points of interest (P, 3)."""
    if mask.is_line:
        raise InvalidInput("mask", "a line of sensors", "a mask of the plane")
    if mask.arrangement.get("arrangement") == "beams":
        raise InvalidInput("mask", "points of several beams", "a mask of single points")
    points = np.asarray(points_of_interest, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not 1 <= len(points) <= MAX_POINTS_OF_INTEREST:
        allowed = f"(P, 3): x, y and depth in m; P from 1 to {MAX_POINTS_OF_INTEREST}"
        raise InvalidInput("points_of_interest", f"an array of shape {points.shape}", allowed)
    for number, (x, y, depth) in enumerate(points):
        where = f"points_of_interest.{number}"
        if not np.isfinite([x, y]).all():
            raise InvalidInput(f"{where}.offset", (float(x), float(y)), "finite (m)")
        try:
            check_offset((float(x), float(y)), mask.aperture)
        except InvalidInput as error:
            raise InvalidInput(f"{where}.{error.field}", error.value, error.allowed) from error
        if not 0 < depth <= LENGTH.limits["le"]:
            raise InvalidInput(f"{where}.depth", float(depth), f"> 0, at most {LENGTH.limits['le']:g} (m)")
    if not MIN_FURTHER_POINTS <= count <= MAX_POINTS - mask.count:
        raise InvalidInput("count", count, f"{MIN_FURTHER_POINTS} to {MAX_POINTS - mask.count} (points)")
    return points


def _outline(mask: Mask, points: Array) -> Outline:
    """Return the sensed region: the hull of the mask's own and of each equi-steradian disc, within the aperture."""
    discs = [
        EquiSteradian.create(aperture=mask.aperture, depth=z, count=MIN_FURTHER_POINTS, offset=(x, y)).outline()
        for x, y, z in points.tolist()
    ]
    half = np.full(2, mask.aperture / 2)
    hull = outlines.convex_hull(np.concatenate([resolve_outline(mask), *discs]))
    return outlines.intersection(hull, outlines.rectangle(-half, half))


def _further_points(mask: Mask, points: Array, count: int, outline: Outline, seed: int) -> Array:
    """Return at most ``count`` further positions by Lloyd's iteration with the mask's points held."""
    from scipy.spatial import KDTree

    held = mask.positions
    density = Density(points, outline, held, count)
    plane = sample_solid_angles(density, outline, seed)
    places, weights = plane.places, plane.weights
    moved = places[stratified_choice(plane, held, count)]
    for _ in range(ITERATIONS):
        owner = np.asarray(KDTree(np.concatenate([held, moved])).query(places)[1]) - len(held)
        own = owner >= 0
        owner, mass, at = owner[own], weights[own], places[own]
        total = np.bincount(owner, mass, len(moved))
        centroid = np.column_stack([np.bincount(owner, mass * axis, len(moved)) for axis in at.T])
        filled = total > 0
        moved[filled] = centroid[filled] / total[filled, None]
    return _drop_close_points(held, moved, density)


def _drop_close_points(held: Array, moved: Array, density: Density) -> Array:
    """Return the further points without those too close to a held or an earlier one."""
    from scipy.spatial import KDTree

    limit = MIN_SPACING_RATIO * density.spacing(moved)
    apart = np.asarray(KDTree(held).query(moved)[0])
    kept = apart >= limit
    for first, second in KDTree(moved).query_pairs(float(limit.max())):
        near = np.linalg.norm(moved[first] - moved[second]) < min(limit[first], limit[second])
        if near and kept[min(first, second)]:
            kept[max(first, second)] = False
    return moved[kept]


def _arrangement(mask: Mask, points: Array, seed: int) -> dict[str, Any]:
    before = mask.arrangement if _is_staged(mask) else {}
    return {
        "arrangement": "staged",
        "survey": before.get("survey", mask.arrangement),
        "stage_ends": [*before.get("stage_ends", []), mask.count],
        "points_of_interest": [
            *before.get("points_of_interest", []),
            *({"depth": z, "offset": [x, y]} for x, y, z in points.tolist()),
        ],
        "points_in_stage": [*before.get("points_in_stage", []), len(points)],
        "seed": seed,
    }
