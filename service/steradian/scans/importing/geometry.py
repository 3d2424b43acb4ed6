"""Placement of imported sensors: fit of a plane or line, centred on a square aperture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.geometry.sensor_areas import detect_sensor_grid
from steradian.masks import Mask, custom_mask
from steradian.masks.explicit_points import area_of_weights
from steradian.masks.modes_from_lattice import FILLED, lattice_modes
from steradian.scans.file.arrangement_metadata import centre_of
from steradian.scans.importing.import_remarks import remark

PLANARITY_TOLERANCE = 1e-4
"""An axis along which the sensors spread less than this share of their largest extent is no axis of theirs."""
SCATTER, SCATTER_SHARE = 10e-6, 0.01
"""Measured positions on a plane may spread so far along its normal, in m and as a share of the extent."""
ROUNDING_TOLERANCE = 1e-5
"""Sensors this little outside the aperture, as a share of its half, are at its rim: float32 files round."""
MOST_POINTS = 1 << 20
ARC_FROM, ARC_TO, ARC_SHARE, ARC_CHORD = 8, 20_000, 0.9, 3.0
"""How many sensors may be an arc, the share of them that are corners of their hull, its chord in median sides."""
DIRECTION_TOLERANCE, SIDEWAYS = 0.05, 0.5
"""How far a direction's length may be from 1; the cosine between it and the normal below which it lies in the plane."""
AXIS_NAMES = "xyz"


@dataclass(frozen=True)
class SensorPlacement:
    """Positions, weights and aperture of imported sensors in the coordinates of the reconstruction.

    Parameters
    ----------
    positions
        (M, 2) metres, or (M, 1) for a line; centred on the aperture.
    aperture
        Side X in metres.
    grid
        Voxels per axis at the pitch of the sensors' lattice where it is an unusual one (:func:`lattice_modes`).
    weights
        (M,) areas of any scale, or ``None``: those of the sensors' cells.
    sensed_area
        What ``weights`` sum to in m² (m for a line); ``None``: found from the positions.
    origin
        What the source's file says of the frame: the names of its lateral axes and the coordinates of our origin.
    """

    positions: NDArray[np.float64]
    aperture: float
    grid: int | None
    weights: NDArray[np.float64] | None
    sensed_area: float | None
    origin: dict[str, Any]

    @property
    def centre(self) -> tuple[float, ...]:
        """Aperture's centre (x, y) in m in the coordinates of the source; () if both frames are the same."""
        return centre_of(self.origin, self.positions.shape[1])

    def mask(self, source: str) -> Mask:
        """Create the mask; sensors without weights get the areas of their Voronoi cells (:func:`custom_mask`).

        Raises
        ------
        InvalidInput
            When a sensor lies outside the aperture, or two at the same place.
        """
        mask = custom_mask(self.positions, self.aperture, self.weights, sensed_area=self.sensed_area)
        return mask.replace(arrangement=mask.arrangement | {"source": source} | self.origin)


def fit_sensor_plane(
    given: NDArray[np.floating[Any]],
    *,
    aperture: float | None = None,
    bounds: NDArray[np.float64] | None = None,
    weights: NDArray[np.float64] | None = None,
    sensed_area: float | None = None,
) -> SensorPlacement:
    """Fit a plane or line to imported sensor positions and centre the positions on the aperture.

    ``bounds`` that are square, hold every sensor and are as wide as ``aperture``, if that is known, are the aperture.
    Else, with ``aperture``, positions count as centred already. Else sensors on a lattice of N places with pitch d, of
    which up to two fifths may be empty, have the aperture N·d and place j at (j − N//2)·d, as the reconstruction's own
    grid; others the smallest square around them, widened by their mean distance.

    Parameters
    ----------
    given
        (M, 1), (M, 2) or (M, 3) metres. Of three axes one must be flat; it is the depth, and the next two in the
        cyclic order x, y, z become our x and y. Two flat axes make a line.
    aperture
        Side X in metres, if known.
    bounds
        (A, 2) lowest and highest coordinate of the aperture along each axis of ``given``, in metres.
    weights
        (M,) areas of any scale, if known.
    sensed_area
        What they sum to in m² (m for a line), if known; more than four apertures is no area, and they are relative.

    Raises
    ------
    InvalidInput
        When there are too many points, they are not finite or on no plane, or do not fit ``aperture``.
    """
    points: NDArray[np.float64] = np.asarray(given, np.float64)
    if points.ndim != 2 or not 1 <= points.shape[1] <= 3 or not 1 <= len(points) <= MOST_POINTS:
        raise InvalidInput("positions", f"an array of shape {points.shape}", f"(M, 1 to 3); M at most {MOST_POINTS}")
    if not np.isfinite(points).all():
        raise InvalidInput("positions", "not all finite", "finite numbers (m)")
    lateral = _lateral_axes(points)
    chosen, box = points[:, lateral], None if bounds is None else bounds[lateral]
    _refuse_arc(chosen, [AXIS_NAMES[axis] for axis in lateral])
    lattice = detect_sensor_grid(chosen, filled=FILLED)
    bounded = box is not None and _is_square_around(box, chosen)
    if box is not None and bounded and (aperture is None or np.isclose(np.ptp(box[0]), aperture, rtol=1e-6)):
        centre, side = box.mean(axis=1), aperture or float(np.ptp(box, axis=1)[0])
    elif aperture is not None:
        centre, side = np.zeros(len(lateral)), aperture
    elif lattice is not None:
        centre = lattice.first + lattice.counts // 2 * lattice.pitch
        side = float((lattice.counts * lattice.pitch).max())
    else:
        low, high = chosen.min(axis=0), chosen.max(axis=0)
        extent = float((high - low).max())
        if not extent > 0:
            raise InvalidInput("aperture", "missing", "> 0, at most 1 (m); all sensors lie at one place")
        centre, side = (low + high) / 2, extent * (1 + 1 / max(1.0, len(points) ** (1 / len(lateral)) - 1))
    placed, half = chosen - centre, side / 2
    if np.abs(placed).max() <= half * (1 + ROUNDING_TOLERANCE):
        placed = np.clip(placed, -half, half)
    return SensorPlacement(
        positions=np.ascontiguousarray(placed),
        aperture=side,
        grid=lattice_modes(placed, side),
        weights=weights,
        sensed_area=area_of_weights(sensed_area, side, len(lateral)),
        origin={"axes": [AXIS_NAMES[axis] for axis in lateral], "centre_m": centre.tolist()},
    )


def _lateral_axes(points: NDArray[np.float64]) -> list[int]:
    spread, dropped = np.ptp(points, axis=0), False
    wide = [axis for axis in range(points.shape[1]) if spread[axis] > PLANARITY_TOLERANCE * spread.max()]
    while len(wide) == 3 or (dropped and len(wide) > 1):
        least = min(wide, key=lambda axis: spread[axis])
        if spread[least] > min(SCATTER, SCATTER_SHARE * spread.max()):
            break
        wide, dropped = [axis for axis in wide if axis != least], True
        remark(
            f"positions spread by {1e6 * spread[least]:.3g} µm along {AXIS_NAMES[least]}, taken as flat (allowed: "
            f"{1e6 * SCATTER:g} µm and {SCATTER_SHARE:.0%} of the extent)"
        )
    if len(wide) == 3:
        words = " × ".join(f"{side:.4g}" for side in spread)
        allowed = (
            f"a plane or a line along the axes, flat to {1e6 * SCATTER:g} µm and {SCATTER_SHARE:.0%} of the extent; "
            "positions may leave out the third coordinate"
        )
        raise InvalidInput("positions", f"sensors that fill {words} m", allowed)
    if len(wide) == 1 and len(points) > 1:
        return wide
    if points.shape[1] < 3:
        return list(range(points.shape[1]))
    depth = next((axis for axis in range(3) if axis not in wide), 2) if wide else 2
    return [(depth + 1) % 3, (depth + 2) % 3]


def _refuse_arc(points: NDArray[np.float64], axes: list[str]) -> None:
    """Raise an error for sensors on an arc, because a curved array is not a planar aperture.

    Each sensor is then a corner of their convex hull, and one of the hull's sides, the chord, is much longer than the
    others. Rings are closed, and those of an L, a cross or a grid are corners but for a few.
    """
    if points.shape[1] != 2 or not ARC_FROM <= len(points) <= ARC_TO:
        return
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners = points[ConvexHull(points).vertices]
    except QhullError:  # on a straight line
        return
    sides = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1))
    if len(corners) >= ARC_SHARE * len(points) and sides[-1] > ARC_CHORD * np.median(sides):
        raise InvalidInput(
            "positions",
            f"{len(points)} sensors on a curve in the plane of {axes[0]} and {axes[1]}",
            "a planar aperture or a straight line; curved arrays cannot be reconstructed",
        )


def refuse_sideways(points: NDArray[np.float64], directions: NDArray[np.float64]) -> None:
    """Raise an error for sensors whose stated directions lie in their plane instead of along its normal.

    Parameters
    ----------
    points
        (M, 3) positions.
    directions
        (K, 3) of some of the sensors; those that are no unit vectors say nothing.
    """
    spread = np.ptp(points, axis=0)
    wide = [axis for axis in range(3) if spread[axis] > PLANARITY_TOLERANCE * spread.max()]
    length = np.linalg.norm(directions, axis=1)
    stated = directions[np.abs(length - 1) < DIRECTION_TOLERANCE]
    if len(wide) != 2 or len(stated) < 2:
        return
    depth = next(axis for axis in range(3) if axis not in wide)
    if np.median(np.abs(stated[:, depth])) < SIDEWAYS:
        names = " and ".join(AXIS_NAMES[axis] for axis in wide)
        raise InvalidInput(
            "positions",
            f"sensors in the plane of {names} that look along it",
            f"sensors that look along {AXIS_NAMES[depth]}, the plane's normal; arcs and rings cannot be reconstructed",
        )


def _is_square_around(box: NDArray[np.float64], points: NDArray[np.float64]) -> bool:
    sides = np.ptp(box, axis=1)
    slack = 1e-9 * sides.max()
    inside = (points >= box[:, 0] - slack).all() and (points <= box[:, 1] + slack).all()
    return bool(sides.min() > 0 and np.ptp(sides) <= 1e-6 * sides.max() and inside)
