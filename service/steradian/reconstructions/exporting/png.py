"""Projections as pictures with axes and a scale bar."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.imaging import Volume, VoxelAxes
from steradian.imaging.signal.conditioning import Display
from steradian.reconstructions.exporting.source import VolumeExportSource
from steradian.reconstructions.volumes.file import read_projection
from steradian.reconstructions.volumes.images import PLANE_LABELS, Axis, draw_projection
from steradian.reconstructions.volumes.near_field import crop_depth


def write_png(source: VolumeExportSource, path: Path) -> None:
    """Draw the z-projection into one file, where ``path`` ends in ``.png``; else all projections into a folder.

    The folder's files are ``mip-x.png`` and so on. An image from a line of sensors has one picture, ``mip-y.png``.
    """
    axes: tuple[Axis, ...] = tuple(PLANE_LABELS) if source.values.ndim == 3 else ("y",)
    display = Display(near_field=float(source.values.attrs.get("near_field_m", 0.0)))
    frame = crop_depth(_frame(source), display.near_field or 0.0)
    single = path.suffix == ".png"
    if single:
        axes = (axes[-1],)
    else:
        path.mkdir()
    for index, axis in enumerate(axes):
        source.check(index, len(axes))
        image = _projection(source, axis, frame.values.shape[-1])
        draw_projection(image, frame, axis, path if single else path / f"mip-{axis}.png", display)
        if source.progress:
            source.progress("pictures", index + 1, len(axes))


def _projection(source: VolumeExportSource, axis: Axis, depths: int) -> NDArray[Any]:
    """Read a projection of the last ``depths``: those along x and y are there, the one along z only of all."""
    if axis != "z" or depths == source.values.shape[-1]:
        image = read_projection(Path(source.values.file.filename), axis)
        return image if axis == "z" else image[..., -depths:]
    return np.stack([source.read(np.s_[x, :, -depths:]).max(axis=-1) for x in range(source.values.shape[0])])


def _frame(source: VolumeExportSource) -> Volume:
    """Make a volume with the axes alone; its values are one number seen from every voxel."""
    lines = [
        first + step * np.arange(count)
        for first, step, count in zip(source.origin, source.spacing, source.values.shape, strict=True)
    ]
    x, *y, z = lines
    values = np.broadcast_to(np.zeros(1, np.float32), source.values.shape)
    return Volume(values, VoxelAxes(x, y[0] if y else None, z), source.spacing)
