"""Multi-beam masks: points that a fixed pattern of several interrogation beams can measure.

The pattern is moved as a whole, so a mask's points cannot be met one by one with few shots. What a mask is for is its
density: the points are taken where beams really are, as many shots as points over beams, at places that leave the
plane covered as evenly as the mask covers it. That is a Voronoi tessellation that is centroidal as far as the pattern
lets it be (Q. Du, V. Faber, M. Gunzburger, "Centroidal Voronoi tessellations", 1999): Lloyd's iteration moves each
place by the mean of what its points' cells pull, weighted with the square of the wanted density, for which the best
points in a plane have that density; with momentum, and shaken less and less, as metals are annealed.
"""

from __future__ import annotations

import re
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput, NotFound
from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.polygons import Outline
from steradian.imaging.geometry.voronoi import voronoi_cell_areas
from steradian.masks.mask import Mask
from steradian.masks.weights import resolve_outline

MOST_BEAMS = 64
"""Most interrogation beams of a scanner."""
NANOMETRE = 1e-9
"""Scanners are told places in whole nanometres."""
SAMPLES = 32
"""Samples of the plane for each point, at which cells are taken; within the next limits in all."""
MIN_ITERATIONS, MAX_ITERATIONS = 5_000, 200_000
ROUNDS = 400
MOMENTUM = 0.8
PERTURBATION, CONVERGENCE = 0.12, 0.8
"""Iterations; of each move what the next one keeps; by how many spacings of points places are shaken at first (standard
deviation), which falls to nothing after that share of the iterations: settled at once, places stay far from even."""

Array = NDArray[np.float64]


def check_beams(beams: ArrayLike) -> Array:
    """Return a validated beam pattern (B, 2) in m relative to its first beam, in whole nanometres."""
    pattern = np.asarray(beams, dtype=np.float64)
    if pattern.ndim != 2 or pattern.shape[1] != 2 or not 1 <= len(pattern) <= MOST_BEAMS:
        raise InvalidInput("beams", f"an array of shape {pattern.shape}", f"(B, 2) in m, B from 1 to {MOST_BEAMS}")
    if not np.isfinite(pattern).all() or (pattern[0] != 0).any():
        raise InvalidInput(
            "beams[0]", ", ".join(f"{value:g}" for value in pattern[0]), "(0, 0): relative to the first beam"
        )
    pattern = np.rint(pattern / NANOMETRE) * NANOMETRE
    if len(np.unique(pattern, axis=0)) < len(pattern):
        raise InvalidInput("beams", "two at the same place", "each at a place of its own")
    return pattern


def read_beams(text: str, spacing: float) -> tuple[tuple[float, float], ...]:
    """Parse a beam pattern: ``16`` in a row, ``4x4`` in a rectangle, ``spacing`` m apart; or a .csv file.

    The file has columns ``x_mm`` and ``y_mm``; places count beside the first one. Raises InvalidInput, NotFound.
    """
    if text.lower().endswith(".csv"):
        return _read_csv(Path(text))
    found = re.fullmatch(r"(\d{1,2})(?:x(\d{1,2}))?", text)
    across, along = (int(found[1]), int(found[2] or 1)) if found else (0, 0)
    if not 1 <= across * along <= MOST_BEAMS:
        raise InvalidInput("beams", text, f"1 to {MOST_BEAMS} in a row (16) or a rectangle (4x4), or a .csv file")
    return tuple((spacing * column, spacing * row) for row in range(along) for column in range(across))


def _read_csv(path: Path) -> tuple[tuple[float, float], ...]:
    if not path.is_file():
        raise NotFound("file", str(path))
    try:
        table = np.atleast_1d(np.genfromtxt(path, delimiter=",", names=True))
        places = 1e-3 * np.column_stack([table["x_mm"], table["y_mm"]])
    except (ValueError, IndexError, TypeError) as error:
        raise InvalidInput("beams", path.name, "a table with columns x_mm and y_mm") from error
    return tuple((float(x), float(y)) for x, y in check_beams(places - places[:1]))


def multi_beam_mask(mask: Mask, beams: ArrayLike, *, places: int | None = None) -> Mask:
    """Return the mask that a pattern of interrogation beams measures in place of another mask.

    Its points are those that beams really sense: point n is that of beam n mod B at place ⌊n / B⌋. Their density is
    the mask's as nearly as the pattern lets it be; their weights are the areas of their own cells.

    Parameters
    ----------
    mask
        What is to be measured; of the plane.
    beams
        (B, 2) where each beam is beside the first one in m, the first being (0, 0); at most 64.
    places
        How many places the pattern is brought to; by default the mask's points over the beams, rounded up.

    Raises
    ------
    InvalidInput
        When the pattern does not fit into what the mask senses, or a parameter is out of range.
    """
    pattern = check_beams(beams)
    if mask.is_line:
        raise InvalidInput("mask", "a line of sensors", "a mask of the plane")
    count = ceil(mask.count / len(pattern)) if places is None else places
    if not 1 <= count <= mask.count:
        raise InvalidInput("places", count, f"1 to {mask.count}")
    outline = resolve_outline(mask)
    normals, limits = _within(outline, pattern, mask.aperture)
    plane, weights = _target_density(mask, outline)
    where = _relax(mask, pattern, count, normals, limits, plane, weights)
    positions = _points(where, pattern)
    held = outlines.contains(outlines.buffered_hull(outline, NANOMETRE), positions).all()
    if not held or np.abs(positions).max() > mask.aperture / 2:
        width, height = 1e3 * np.ptp(pattern, axis=0)
        wide, high = 1e3 * np.ptp(np.clip(outline, -mask.aperture / 2, mask.aperture / 2), axis=0)
        raise InvalidInput(
            "beams",
            f"a pattern of {width:.3g} mm × {height:.3g} mm",
            f"one that fits into the mask's sensed region, whose extent is {wide:.3g} mm × {high:.3g} mm",
        )
    off = _distance(mask.positions, positions)
    return mask.replace(
        positions=positions,
        weights=voronoi_cell_areas(positions, outline),
        outline=outline,
        arrangement={
            "arrangement": "beams",
            "of": mask.id,
            "asked": mask.count,
            "places": count,
            "beams": pattern.tolist(),
            "weighting": "voronoi",
            "displacement": {"median": float(np.median(off)), "largest": float(off.max())},
        },
    )


def _points(places: Array, pattern: Array) -> Array:
    """Return the points (S·B, 2) of all beams for positions (S, 2) of the first one."""
    points: Array = (places[:, None] + pattern).reshape(-1, 2)
    return points


def _distance(of: Array, to: Array) -> Array:
    """Return the distance (M,) of each of (M, 2) points to the nearest of ``to``."""
    from scipy.spatial import KDTree

    return np.asarray(KDTree(to).query(of)[0])


def _within(outline: Outline, pattern: Array, aperture: float) -> tuple[Array, Array]:
    """Return half-planes n·x ≤ limit of first-beam positions with all beams within outline and aperture.

    Cells of a grid's outermost points reach beyond the aperture.
    """
    side = np.roll(outline, -1, axis=0) - outline
    length = np.linalg.norm(side, axis=1)
    side, corner = side[length > 0] / length[length > 0, None], outline[length > 0]
    normals = np.vstack([np.column_stack([side[:, 1], -side[:, 0]]), np.eye(2), -np.eye(2)])
    farthest = np.append((normals[:-4] * corner).sum(axis=1), np.full(4, aperture / 2))
    reach = (normals @ pattern.T).max(axis=1)
    return normals, farthest - reach - NANOMETRE


def _target_density(mask: Mask, outline: Outline) -> tuple[Array, Array]:
    """Return sample points (G, 2) within the outline, and the square of the mask's density there (G,)."""
    from scipy.spatial import KDTree

    low, high = outline.min(axis=0), outline.max(axis=0)
    side = np.sqrt(np.prod(high - low) / np.clip(SAMPLES * mask.count, MIN_ITERATIONS, MAX_ITERATIONS))
    axes = [np.arange(a + side / 2, b, side) for a, b in zip(low, high, strict=True)]
    plane = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    plane = plane[outlines.contains(outline, plane)]
    cells = voronoi_cell_areas(mask.positions, outline)
    return plane, cells[KDTree(mask.positions).query(plane)[1]] ** -2.0


def _relax(
    mask: Mask, pattern: Array, count: int, normals: Array, limits: Array, plane: Array, weights: Array
) -> Array:
    """Return the first-beam positions (S, 2) of the most uniform coverage found by relaxation."""
    from scipy.spatial import KDTree

    random = np.random.default_rng(0)
    drawn = random.choice(mask.count, count, replace=False)
    where = _project_to_constraints(mask.positions[drawn] - pattern.mean(axis=0), normals, limits)
    spacing = np.sqrt(np.ptp(plane, axis=0).prod() / (count * len(pattern)))
    best, least, move = where, np.inf, np.zeros_like(where)
    for shaking in PERTURBATION * spacing * np.maximum(1 - np.arange(ROUNDS) / (CONVERGENCE * ROUNDS), 0):
        points = _points(where, pattern)
        far, nearest = KDTree(points).query(plane, workers=-1)
        uneven = float((weights * far**2).sum())
        if uneven < least:
            best, least = where, uneven
        mass = np.bincount(nearest, weights, len(points))
        sums = np.column_stack([np.bincount(nearest, weights * axis, len(points)) for axis in plane.T])
        pull = (sums - mass[:, None] * points).reshape(count, -1, 2).sum(axis=1)
        pull /= np.maximum(mass.reshape(count, -1).sum(axis=1), np.finfo(float).tiny)[:, None]
        move = MOMENTUM * move + pull
        where = _project_to_constraints(where + move + shaking * random.normal(size=where.shape), normals, limits)
    return best


def _project_to_constraints(places: Array, normals: Array, limits: Array) -> Array:
    """Move positions (S, 2) into the intersection of all half-planes, the most violated one first."""
    for _ in range(64):
        beyond = places @ normals.T - limits
        worst = beyond.argmax(axis=1)
        over = np.maximum(beyond[np.arange(len(places)), worst], 0)
        if not over.any():
            break
        places = places - over[:, None] * normals[worst]
    return np.rint(places / NANOMETRE) * NANOMETRE
