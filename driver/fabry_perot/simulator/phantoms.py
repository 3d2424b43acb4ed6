"""Phantoms with a closed-form pressure: sets of Gaussian balls, and a knotted yarn made of balls.

A ball of initial pressure ``A·exp(−|r − r₀|²/2s²)`` in a homogeneous medium gives, at distance R from its centre,

    p(R, t) = A/(2R) · [(R − ct)·exp(−(R − ct)²/2s²) + (R + ct)·exp(−(R + ct)²/2s²)]

which is d'Alembert's solution of the wave equation for R·p with even initial data and no initial velocity. All
quantities are in SI units, z points from the sensor plane z = 0 into the object.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
WINDOW = 6.0
"""A ball's pressure is evaluated within so many s of its arrival; the rest is below 10⁻⁷ of its peak."""
_BLOCK = 8192
"""Pairs of position and ball evaluated together, so that temporary arrays stay in cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Balls:
    """Phantom made of Gaussian balls of initial pressure.

    Parameters
    ----------
    centres
        (B, 3) x, y, z in m.
    sigmas
        (B,) standard deviations in m.
    amplitudes
        (B,) initial pressure at the centres, in any pressure unit.
    """

    centres: Array
    sigmas: Array
    amplitudes: Array

    def __post_init__(self) -> None:
        count = len(self.sigmas)
        if self.centres.shape != (count, 3) or self.amplitudes.shape != (count,) or count == 0:
            raise ValueError("balls need (B, 3) centres, (B,) sigmas and (B,) amplitudes, B ≥ 1")
        if not np.all(self.sigmas > 0):
            raise ValueError("sigmas must be > 0 m")


Directivity = Callable[[Array], Array]
"""Response of a detector to sound from the angle of a given cosine to its axis; any shape in, the same out."""


def pressure(
    balls: Balls,
    positions: ArrayLike,
    times: ArrayLike,
    sound_speed: float,
    directivity: Directivity | None = None,
) -> NDArray[np.float32]:
    """Return the pressure that the balls cause at detection points over time.

    Parameters
    ----------
    balls
        The object.
    positions
        (M, 2) x, y on the plane z = 0, or (M, 3); in m.
    times
        (N_t,) s after the laser pulse; fastest when equally spaced.
    sound_speed
        In m/s.
    directivity
        Weighs each ball by the angle under which the film sees it; ``None``: an ideal point detector.

    Returns
    -------
    ndarray
        (M, N_t) float32, in the unit of the amplitudes. One row does not depend on which others are asked for.
    """
    where = _positions(positions)
    t = np.asarray(times, dtype=np.float64)
    result = np.zeros((len(where), len(t)), np.float32)
    rows = max(1, _BLOCK // len(balls.sigmas))
    step = (t[-1] - t[0]) / (len(t) - 1) if len(t) > 1 else 0.0
    uniform = step > 0 and bool(np.all(np.abs(np.diff(t) - step) < 1e-6 * step))
    for first in range(0, len(where), rows):
        block = where[first : first + rows]
        weights = np.ones((len(block), len(balls.sigmas)))
        if directivity is not None:
            across = np.abs(block[:, 2:] - balls.centres[:, 2])
            weights = directivity(across / np.maximum(_distances(balls, block), 1e-12))
        if uniform:
            result[first : first + rows] = _windowed(balls, block, t[0], step, len(t), sound_speed, weights)
        else:
            result[first : first + rows] = _dense(balls, block, t, sound_speed, weights)
    return result


def _positions(positions: ArrayLike) -> Array:
    where = np.atleast_2d(np.asarray(positions, dtype=np.float64))
    if where.ndim != 2 or where.shape[1] not in (2, 3):
        raise ValueError(f"positions have shape {where.shape}; allowed: (M, 2) or (M, 3), in m")
    if where.shape[1] == 2:
        where = np.column_stack([where, np.zeros(len(where))])
    return where


def _distances(balls: Balls, where: Array) -> Array:
    offset = where[:, None, :] - balls.centres[None, :, :]
    distances: Array = np.sqrt(np.einsum("pbi,pbi->pb", offset, offset))
    return distances


def _windowed(
    balls: Balls, where: Array, start: float, step: float, samples: int, sound_speed: float, weights: Array
) -> Array:
    """Return (P, N_t) pressure, evaluated only for samples near each ball's arrival.

    With u = R − ct on a grid of spacing d around the nearest sample, exp(−u²/2s²) factors into one exponential per
    pair, powers of another, and a table over the offset k that depends on the ball alone: no exponential in the loop.
    """
    d = sound_speed * step
    distance = _distances(balls, where)
    near = distance < (WINDOW + 1) * balls.sigmas
    half = int(np.ceil(WINDOW * balls.sigmas.max() / d))
    centre = np.rint((distance / sound_speed - start) / step)
    u0 = distance - sound_speed * (start + centre * step)
    variance = balls.sigmas**2
    amplitude = np.where(near, 0.0, weights * balls.amplitudes / (2 * np.maximum(distance, 1e-12)))
    amplitude *= np.exp(-(u0**2) / (2 * variance))
    ratio = np.exp(u0 * d / variance)
    k = np.arange(-half, half + 1)
    table = np.exp(-((k[:, None] * d) ** 2) / (2 * variance))
    values = np.empty((len(k), *distance.shape))
    for direction, base in ((1, ratio), (-1, 1 / ratio)):
        power = amplitude.copy()
        for j in range(half + 1):
            row = half + direction * j
            np.multiply(u0 - (direction * j) * d, power, out=values[row])
            values[row] *= table[row]
            power *= base
    margin = 2 * half + 1
    width = samples + 2 * margin
    column = np.clip(centre, -half - 1, samples + half).astype(np.intp) + margin
    index = column + width * np.arange(len(where))[:, None]
    pairs = (index[None] + k[:, None, None]).ravel()
    flat = np.bincount(pairs, values.ravel(), minlength=width * len(where)).astype(np.float64, copy=False)
    sums: Array = flat.reshape(len(where), width)[:, margin : margin + samples]
    times: Array = start + step * np.arange(samples, dtype=np.float64)
    for p in np.flatnonzero(near.any(axis=1)):
        some = near[p]
        close = Balls(balls.centres[some], balls.sigmas[some], balls.amplitudes[some])
        sums[p] += _dense(close, where[p : p + 1], times, sound_speed, weights[p : p + 1, some])[0]
    return sums


def _dense(balls: Balls, where: Array, times: Array, sound_speed: float, weights: Array | None = None) -> Array:
    """Return (P, N_t) pressure, evaluated by the full formula for all samples, with its limit at R → 0."""
    ct = sound_speed * times
    total = np.zeros((len(where), len(times)))
    amplitudes = balls.amplitudes * (np.ones((len(where), 1)) if weights is None else weights)
    for distances, strengths, row in zip(_distances(balls, where), amplitudes, total, strict=True):
        r = distances[:, None]
        s2 = balls.sigmas[:, None] ** 2
        safe = np.maximum(r, 1e-6 * np.sqrt(s2))
        out = (safe - ct) * np.exp(-((safe - ct) ** 2) / (2 * s2))
        back = (safe + ct) * np.exp(-((safe + ct) ** 2) / (2 * s2))
        row += np.sum(strengths[:, None] * (out + back) / (2 * safe), axis=0)
    return total


def initial_pressure(balls: Balls, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> NDArray[np.float32]:
    """Return the initial pressure of the balls on a grid.

    Parameters
    ----------
    balls
        The object.
    x, y, z
        (N_x,), (N_y,), (N_z,) ascending coordinates in m.

    Returns
    -------
    ndarray
        (N_x, N_y, N_z) float32, axes x, y, z, z contiguous.
    """
    axes = [np.asarray(axis, dtype=np.float64) for axis in (x, y, z)]
    volume = np.zeros([len(axis) for axis in axes], np.float32)
    for centre, sigma, amplitude in zip(balls.centres, balls.sigmas, balls.amplitudes, strict=True):
        window, profiles = [], []
        for axis, middle in zip(axes, centre, strict=True):
            low, high = np.searchsorted(axis, [middle - WINDOW * sigma, middle + WINDOW * sigma])
            window.append(slice(int(low), int(high)))
            profiles.append(np.exp(-((axis[low:high] - middle) ** 2) / (2 * sigma**2)))
        volume[tuple(window)] += amplitude * np.einsum("i,j,k->ijk", *profiles)
    return volume


def yarn(seed: int = 0, *, centre: tuple[float, float, float] = (0.0, 0.0, 3.6e-3), radius: float = 3.0e-3) -> Balls:
    """Return the phantom of a yarn with an overhand knot (an open trefoil) and two loose ends.

    Parameters
    ----------
    seed
        Varies the fibre's wiggle, thickness and absorption.
    centre
        Middle of the knot, in m.
    radius
        Distance of the knot's lobes from its middle, in m.

    Returns
    -------
    Balls
        Some 620 balls with s of 40–50 µm, closer than 1.2 s to their neighbours, so the yarn looks continuous.
    """
    random = np.random.default_rng(seed)
    t = np.pi + np.linspace(0.45, 2 * np.pi - 0.45, 4000)
    knot = np.column_stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -0.75 * np.sin(3 * t)])
    curve = _with_loose_ends(knot / 3.0)
    curve = radius * curve
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    count = int(length[-1] / 46e-6) + 1
    along = np.linspace(0.0, length[-1], count)
    centres = np.column_stack([np.interp(along, length, curve[:, axis]) for axis in range(3)])
    phase = along / length[-1]
    centres += 25e-6 * np.column_stack([_smooth(random, phase) for _ in range(3)])
    sigmas = 45e-6 * (1 + 0.11 * np.tanh(_smooth(random, phase)))
    amplitudes = 1.0 + 0.2 * np.tanh(_smooth(random, phase))
    return Balls(centres + np.asarray(centre), sigmas, amplitudes)


def _with_loose_ends(knot: Array) -> Array:
    """Return the open curve with both ends extended outwards in a gentle bend."""
    s = np.linspace(0.0, 1.0, 400)[1:, None]
    ends = []
    for tip, inner in ((knot[0], knot[1]), (knot[-1], knot[-2])):
        tangent = (tip - inner) / np.linalg.norm(tip - inner)
        bend = np.array([-0.5 * np.sign(tip[0]), 0.2, 0.0])
        ends.append(tip + 0.5 * s * tangent + bend * s**2)
    return np.concatenate([ends[0][::-1], knot, ends[1]])


def _smooth(random: np.random.Generator, phase: Array) -> Array:
    """Return a smooth random curve of unit size over ``phase`` in 0 … 1."""
    harmonics = np.arange(1, 9)
    weights = random.normal(size=(2, len(harmonics))) / np.sqrt(len(harmonics))
    angle = 2 * np.pi * phase[:, None] * harmonics
    curve: Array = np.cos(angle) @ weights[0] + np.sin(angle) @ weights[1]
    return curve
