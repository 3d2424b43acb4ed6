"""Two-dimensional phantom of a bare tree, after the paper's section 5."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.volume import Volume, VoxelAxes

Array = NDArray[np.float64]
Segment = tuple[Array, Array, float]


def tree(
    seed: int = 0,
    *,
    levels: int = 5,
    thinnest: float = 4.0,
    shape: tuple[int, int] = (1024, 256),
    spacing: float = 60e-6,
) -> Volume:
    """Return a 2-D image of a bare tree on a line of ground, the crown towards the sensors.

    Parameters
    ----------
    seed
        Varies the branches.
    levels
        Times that branches fork.
    thinnest
        Width of the thinnest twigs in 256ths of the depth.
    shape
        Columns and depths; the tree keeps its place in the middle and fills about the same part of the depth.
    spacing
        Of both, in m.

    Returns
    -------
    Volume
        Initial pressure [x, z] from 0 to 1, edges two pixels soft so that the grid carries all of it; column i lies at
        (i − N/2)·spacing, row j at depth j·spacing.
    """
    nx, nz = shape
    random = np.random.default_rng([seed, 23])
    unit = nz / 256
    segments = [
        (np.array([0.0, 226.0]), np.array([0.0, 160.0]), 12.0),
        (np.array([-70.0, 226.0]), np.array([70.0, 226.0]), 4.0),
    ]
    _grow(random, segments, np.array([0.0, 162.0]), -np.pi / 2, 46.0, 9.0, levels, thinnest)
    x, z = (np.arange(nx) - nx // 2) / unit, np.arange(nz) / unit
    image = np.zeros(shape, np.float32)
    for start, end, width in segments:
        _draw(image, x, z, start, end, width, unit)
    axes = VoxelAxes(
        spacing * (np.arange(nx, dtype=np.float64) - nx // 2), None, spacing * np.arange(nz, dtype=np.float64)
    )
    return Volume(image, axes, (spacing, spacing))


def _grow(
    random: np.random.Generator,
    segments: list[Segment],
    root: Array,
    heading: float,
    length: float,
    width: float,
    levels: int,
    thinnest: float,
) -> None:
    """Add two branches and, recursively, their sub-branches."""
    for side in (-1, 1):
        towards = heading + side * random.uniform(0.2, 0.7) + random.normal(0, 0.1)
        reach = length * random.uniform(0.7, 1.05)
        tip = root + reach * np.array([np.cos(towards), np.sin(towards)])
        if not 40 <= tip[1] <= 205 or abs(tip[0]) > 115:
            continue
        segments.append((root, tip, width))
        if levels > 1:
            _grow(random, segments, tip, towards, 0.78 * length, max(thinnest, 0.72 * width), levels - 1, thinnest)


def _draw(image: NDArray[np.float32], x: Array, z: Array, start: Array, end: Array, width: float, unit: float) -> None:
    """Draw a segment of a given width into the image, with an antialiased edge of two pixels."""
    reach = width / 2 + 2 / unit
    some = np.ix_(
        np.flatnonzero((x >= min(start[0], end[0]) - reach) & (x <= max(start[0], end[0]) + reach)),
        np.flatnonzero((z >= min(start[1], end[1]) - reach) & (z <= max(start[1], end[1]) + reach)),
    )
    px, pz = x[some[0]], z[some[1]]
    along = end - start
    place = np.clip(((px - start[0]) * along[0] + (pz - start[1]) * along[1]) / (along @ along), 0, 1)
    distance = np.hypot(px - start[0] - place * along[0], pz - start[1] - place * along[1])
    edge = np.clip(0.5 + unit * (width / 2 - distance) / 2, 0, 1)
    image[some] = np.maximum(image[some], edge**2 * (3 - 2 * edge))
