"""Further phantoms of Gaussian balls: a tree, a star, resolution bars, a vessel tree, a volume from a file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

from fabry_perot.simulator.phantoms import Balls, yarn

Array = NDArray[np.float64]
NAMES = ("yarn", "tree", "star", "usaf", "vessels")
"""Objects that :func:`by_name` makes; anything else is the path of a file."""
MAX_BALLS = 4000
"""Most balls made of a volume: an A-line's cost grows with them."""


def by_name(name: str, seed: int = 0) -> Balls:
    """Return a phantom by its name, or from the file of that name (see :func:`from_file`)."""
    makers: dict[str, Callable[[int], Balls]] = dict(zip(NAMES, (yarn, tree, star, usaf, vessels), strict=True))
    return makers[name](seed) if name in makers else from_file(Path(name))


def line(start: Array, stop: Array, sigma: float, amplitude: float = 1.0) -> Balls:
    """Return a straight line from (3,) to (3,) in m, made of balls 1.1 standard deviations apart."""
    count = max(2, int(np.linalg.norm(stop - start) / (1.1 * sigma)) + 1)
    along = np.linspace(0.0, 1.0, count)[:, None]
    return Balls(start + along * (stop - start), np.full(count, sigma), np.full(count, amplitude))


def concatenate(parts: list[Balls]) -> Balls:
    """Return the union of the balls of several phantoms."""
    return Balls(
        np.concatenate([part.centres for part in parts]),
        np.concatenate([part.sigmas for part in parts]),
        np.concatenate([part.amplitudes for part in parts]),
    )


def tree(seed: int = 0, *, levels: int = 5) -> Balls:
    """Return the phantom of a flat tree with straight branches that fork and thin out, 3 mm below the film."""
    return _grow(np.random.default_rng(seed), levels, spread=0.45, depth=0.0)


def vessels(seed: int = 0, *, levels: int = 6) -> Balls:
    """Return the phantom of a vessel tree that bends and descends between 1 and 6 mm below the film."""
    return _grow(np.random.default_rng(seed), levels, spread=0.6, depth=0.5)


def _grow(random: np.random.Generator, levels: int, *, spread: float, depth: float) -> Balls:
    """Return a forking tree; ``spread`` is the fork angle in rad, ``depth`` its share out of the plane."""
    parts = []
    tips = [(np.array([0.0, -4e-3, 3e-3]), np.array([0.0, 1.0, 0.0]), 90e-6)]
    for level in range(levels):
        following = []
        for tip, direction, sigma in tips:
            end = tip + direction * 2.6e-3 * 0.78**level
            end[2] = np.clip(end[2], 1e-3, 6e-3)
            parts.append(line(tip, end, sigma))
            for side in (-1.0, 1.0):
                angle = side * spread * (0.7 + 0.6 * random.random())
                turned = _turn(direction, angle, depth * side * (random.random() - 0.3))
                following.append((end, turned, max(35e-6, 0.82 * sigma)))
        tips = following
    return concatenate(parts)


def _turn(direction: Array, angle: float, dive: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = direction
    turned: Array = np.array([c * x - s * y, s * x + c * y, z + dive])
    return turned / np.linalg.norm(turned)


def star(seed: int = 0, *, arms: int = 12, radius: float = 4e-3) -> Balls:
    """Return the phantom of a Siemens star of ``arms`` spokes, 2.5 mm below the film, to judge resolution."""
    offset = np.random.default_rng(seed).random() * 2 * np.pi / arms
    parts = []
    for angle in offset + 2 * np.pi * np.arange(arms) / arms:
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        middle = np.array([0.0, 0.0, 2.5e-3])
        parts.append(line(middle + 0.12 * radius * out, middle + radius * out, 45e-6))
    return concatenate(parts)


def usaf(seed: int = 0) -> Balls:
    """Return groups of three bars like a USAF 1951 target, 2 mm below the film, each group finer by 2^(1/3)."""
    parts = []
    x, y, pitch = -4.5e-3, 3e-3, 0.8e-3
    for _ in range(10):
        sigma = max(20e-6, pitch / 8)
        for bar in range(3):
            at = np.array([x + bar * pitch, y, 2e-3])
            parts.append(line(at, at + np.array([0.0, -2.5 * pitch, 0.0]), sigma))
            across = np.array([x, y - (3.5 + bar) * pitch, 2e-3])
            parts.append(line(across, across + np.array([2.0 * pitch, 0.0, 0.0]), sigma))
        x += 3.6 * pitch
        pitch /= 2 ** (1 / 3)
        if x > 4e-3:
            x, y = -4.5e-3, y - 5.0e-3
    return concatenate(parts)


def from_file(path: Path) -> Balls:
    """Read a phantom from a NumPy archive (npz).

    It holds either balls (``centres`` (B, 3) m, ``sigmas`` (B,) m, ``amplitudes`` (B,)) or a ``volume`` (N_x, N_y, N_z)
    with the ``spacing`` of its voxels and the ``origin`` of the first one, (3,) each, in m; the strongest voxels, 4,000
    at most, become balls of half a voxel's size.

    Raises
    ------
    ValueError
        It holds neither.
    OSError
        It cannot be read.
    """
    try:
        archive = np.load(path, allow_pickle=False)
    except BadZipFile as error:
        raise ValueError(f"{path} is damaged: {error}") from error
    if not isinstance(archive, NpzFile):
        raise ValueError(
            f"{path} holds one array; expected: an archive (npz) of balls, or of volume, spacing and origin"
        )
    with archive as file:
        if {"centres", "sigmas", "amplitudes"} <= set(file.files):
            return Balls(*(file[name].astype(np.float64) for name in ("centres", "sigmas", "amplitudes")))
        if not {"volume", "spacing", "origin"} <= set(file.files):
            raise ValueError(f"{path} holds {sorted(file.files)}; expected: balls, or volume, spacing and origin")
        volume, spacing, origin = (file[name].astype(np.float64) for name in ("volume", "spacing", "origin"))
    strength = np.abs(volume).ravel()
    strongest = np.argsort(strength)[::-1][:MAX_BALLS]
    strongest = strongest[strength[strongest] > 0]
    if volume.ndim != 3 or len(strongest) == 0:
        raise ValueError(f"{path}: the volume has shape {volume.shape}; expected: three axes, not all zero")
    index = np.column_stack(np.unravel_index(strongest, volume.shape))
    sigma = np.full(len(strongest), float(spacing.mean()) / 2)
    return Balls(origin + index * spacing, sigma, volume.ravel()[strongest])
