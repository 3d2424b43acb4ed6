"""Projections as pictures with axes and a scale bar."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from steradian.imaging import Axes, Volume
from steradian.reconstructions.exporting.source import VolumeSource
from steradian.reconstructions.pictures import PLANES, draw_projection
from steradian.reconstructions.volume_file import read_projection


def write_png(source: VolumeSource, path: Path) -> None:
    """Draw the z-projection into one file, where ``path`` ends in ``.png``; else all projections into a folder.

    The folder's files are ``mip-x.png`` and so on. An image from a line of sensors has one picture, ``mip-y.png``.
    """
    axes = tuple(PLANES) if source.values.ndim == 3 else ("y",)
    frame = _frame(source)
    single = path.suffix == ".png"
    if single:
        axes = (axes[-1],)
    else:
        path.mkdir()
    for index, axis in enumerate(axes):
        source.check(index, len(axes))
        image = read_projection(Path(source.values.file.filename), axis)
        draw_projection(image, frame, axis, path if single else path / f"mip-{axis}.png")
        if source.progress:
            source.progress("pictures", index + 1, len(axes))


def _frame(source: VolumeSource) -> Volume:
    """Make a volume with the axes alone; its values are one number seen from every voxel."""
    lines = [
        first + step * np.arange(count)
        for first, step, count in zip(source.origin, source.spacing, source.values.shape, strict=True)
    ]
    x, *y, z = lines
    values = np.broadcast_to(np.zeros(1, np.float32), source.values.shape)
    return Volume(values, Axes(x, y[0] if y else None, z), source.spacing)
