"""Newton iteration that equalises the solid angles of the slices' Voronoi cells.

Points at the middle of equal units are not yet alike: where a slice doubles its number of points, the border between
its cells and those of the slice before lies off the border between the units. The few points near the pole feel
it most. Moving the slices a little, none of them far, mends that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import cos, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.masks.cap_slices import Slices

OVERHANG = 0.25
"""Part of the last slice that lies beyond the rim.

By the paper's text it ends on the rim (0); its ratio of weights, 9.7, is that of points on the rim itself (0.5), and
then the way through all points is longer. Between the two the ratio is 9.4.
"""
INNER = 36
"""So many slices around the pole are moved; farther out doublings are rare and the cells equal to some per cent."""
ROUNDS = 12
RIM_SHARE = 0.4
"""Weight of the slice before the last, whose cells often reach beyond the rim."""
DAMPING = 0.1
"""Cost of moving a slice by its distance from the one before, in units of the cells' variance."""
TOLERANCE = 0.02
"""Stop when a round betters the whole by less than this part."""
DIRECTIONS = 96
"""Rays by which the outline of a cell is sampled; its area is then right to about 1e-4."""
NEIGHBOUR_RADIUS = 2
"""A cell's neighbours lie at most so many slices away …"""
WINDOW = 9
"""… and are among so many of the points nearest in azimuth."""
SAMPLES = 4
"""Cells of a slice that are looked at: its points differ a little in how they face the slices around."""


@lru_cache(maxsize=64)
def equalise_solid_angles(slices: Slices, rim: float) -> Slices:
    """Adjust the slices' angles until the cells within the rim cover equal solid angles.

    Parameters
    ----------
    slices
        As cut by :func:`steradian.masks.cap_slices.slice_cap`.
    rim
        Polar angle of the cap's rim in radians.

    Notes
    -----
    Least squares by Levenberg and Marquardt over the polar angles. A slice moves only the cells of the slices within
    :data:`NEIGHBOUR_RADIUS`, so every fifth column of the Jacobian comes from one evaluation.
    """
    counts = np.array(slices.counts)
    angles = _initial_slices(slices.counts, rim)
    free = min(len(counts) - 2, INNER)
    cells = _Cells.around(slices, min(len(counts), free + 2 * NEIGHBOUR_RADIUS))
    share = counts[: free + 1] * 1.0
    if free == len(counts) - 2:
        share[-1] *= RIM_SHARE
    share /= share.sum()

    def unevenness(angles: NDArray[np.float64]) -> NDArray[np.float64]:
        areas = cells.areas(angles)[: free + 1]
        found: NDArray[np.float64] = np.sqrt(share) * (areas / (share * areas).sum() - 1)
        return found

    start, gaps = angles, np.diff(angles)[:free]
    stay = np.sqrt(DAMPING * share[1:])

    def cost(angles: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([unevenness(angles), stay * (angles - start)[1 : free + 1] / gaps])

    damping, now = 1e-3, cost(angles)
    for _ in range(ROUNDS if free > 0 else 0):
        slope = np.concatenate([_jacobian(unevenness, angles, now[: free + 1], free), np.diag(stay / gaps)])
        normal = slope.T @ slope
        before = now @ now
        while damping < 1e3:
            move = np.linalg.solve(normal + damping * np.diag(normal.diagonal()), -slope.T @ now)
            moved = _moved(angles, move)
            after = cost(moved)
            if after @ after < before:
                angles, now, damping = moved, after, damping / 5
                break
            damping *= 5
        if now @ now > (1 - TOLERANCE) * before:
            break
    return replace(slices, angles=tuple(float(angle) for angle in angles))


def _jacobian(
    unevenness: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    angles: NDArray[np.float64],
    now: NDArray[np.float64],
    free: int,
) -> NDArray[np.float64]:
    """Return the Jacobian (free + 1, free) of the cells' unevenness by the angles of slices 1 … free."""
    slope = np.zeros((free + 1, free))
    for first in range(1, min(2 * NEIGHBOUR_RADIUS + 1, free) + 1):
        moved = np.arange(first, free + 1, 2 * NEIGHBOUR_RADIUS + 1)
        step = 1e-3 * np.diff(angles)[moved - 1]
        changed = angles.copy()
        changed[moved] += step
        change = unevenness(changed) - now
        for slice_, size in zip(moved, step, strict=True):
            rows = slice(max(0, slice_ - NEIGHBOUR_RADIUS), slice_ + NEIGHBOUR_RADIUS + 1)
            slope[rows, slice_ - 1] = change[rows] / size
    return slope


def _moved(angles: NDArray[np.float64], move: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return the angles after a damped Newton step: at most 0.3 of the distance to the next slice."""
    gaps = np.diff(angles)
    room = 0.3 * np.minimum(gaps[: len(move)], gaps[1 : len(move) + 1])
    moved = angles.copy()
    moved[1 : len(move) + 1] += np.clip(move, -room, room)
    return moved


def unit_angle(counts: Sequence[int], rim: float) -> float:
    """Return the solid angle in steradians of each point of slices that fill a cap, overhang included."""
    return 2 * pi * (1 - cos(rim)) / (sum(counts) - OVERHANG * counts[-1])


def _initial_slices(counts: Sequence[int], rim: float) -> NDArray[np.float64]:
    """Return the initial mid angles of slices of equal units, the last of which overhangs the rim."""
    units = np.concatenate([[0], np.cumsum(counts)])
    border = np.arccos(np.maximum(1 - unit_angle(counts, rim) / (2 * pi) * units, -1.0))
    angles: NDArray[np.float64] = (border[:-1] + border[1:]) / 2
    angles[0] = 0.0
    return angles


@dataclass(frozen=True)
class _Cells:
    """Spherical Voronoi cells of sample points of each slice, and their candidate neighbours.

    Attributes
    ----------
    near
        (K, N) slice of each neighbour.
    turn
        (K, N, SAMPLES) azimuth of each neighbour, counted from the cell's point.
    known
        (K, N) whether there is such a neighbour.
    """

    near: NDArray[np.int64]
    turn: NDArray[np.float64]
    known: NDArray[np.bool_]

    @classmethod
    def around(cls, slices: Slices, size: int) -> _Cells:
        """Return the cells of the first ``size`` slices with their neighbours."""
        width = 2 * NEIGHBOUR_RADIUS + 1
        near = np.zeros((size, width, WINDOW), np.int64)
        turn = np.zeros((size, width, WINDOW, SAMPLES))
        known = np.zeros((size, width, WINDOW), bool)
        azimuths = slices.azimuths(size)
        for k, own in enumerate(azimuths):
            samples = own[np.arange(SAMPLES) % len(own)]
            for step in range(max(-NEIGHBOUR_RADIUS, -k), min(NEIGHBOUR_RADIUS, size - 1 - k) + 1):
                points = azimuths[k + step]
                closest = np.rint((samples - points[0]) / (2 * pi) * len(points)).astype(int)
                around = np.arange(min(WINDOW, len(points))) - WINDOW // 2
                place = (k, step + NEIGHBOUR_RADIUS, slice(len(around)))
                near[place], known[place] = k + step, True
                turn[place] = points[(closest + around[:, None]) % len(points)] - samples
        flat = (size, width * WINDOW)
        return cls(near.reshape(flat), turn.reshape(*flat, SAMPLES), known.reshape(flat))

    def areas(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mean solid angle in steradians of the cells of each slice, shape (K,).

        Seen from its point p, along the tangent direction u, a cell ends at the tangent of ρ with
        1/ρ = max over neighbours q of (q·u) / (1 − p·q); its solid angle is ∮ (1 − 1/√(1 + ρ²)) du.
        """
        own = angles[: len(self.near), None, None]
        polar = angles[self.near][:, :, None]
        half_turn = np.sin(self.turn / 2) ** 2
        # q in the frame (along the meridian, along the parallel) of the tangent plane at p
        along = np.sin(polar - own) - 2 * np.sin(polar) * np.cos(own) * half_turn
        across = np.sin(polar) * np.sin(self.turn)
        apart = 2 * np.sin((polar - own) / 2) ** 2 + 2 * np.sin(polar) * np.sin(own) * half_turn  # 1 − p·q
        usable = self.known[:, :, None] & (apart > 1e-15)
        apart = np.where(usable, apart, 1.0)
        along, across = np.where(usable, along / apart, 0.0), np.where(usable, across / apart, 0.0)
        inverse = np.full((len(self.near), SAMPLES, DIRECTIONS), 1e-3)
        phi = 2 * pi * np.arange(DIRECTIONS) / DIRECTIONS
        for n in range(self.near.shape[1]):
            ray = along[:, n, :, None] * np.cos(phi) + across[:, n, :, None] * np.sin(phi)
            np.maximum(inverse, ray, out=inverse)
        found: NDArray[np.float64] = 2 * pi * (1 - 1 / np.sqrt(1 + inverse**-2)).mean(axis=(1, 2))
        return found
