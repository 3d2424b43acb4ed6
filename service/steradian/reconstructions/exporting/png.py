"""Export of a volume's projections as PNG images with axes and a scale bar."""

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
    """Draw all projections of a volume into a folder, or only the z-projection if ``path`` ends in ``.png``.

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
    """Return a projection of the last ``depths`` depths: the stored one if possible, else computed from the values."""
    if axis != "z" or depths == source.values.shape[-1]:
        image = read_projection(Path(source.values.file.filename), axis)
        return image if axis == "z" else image[..., -depths:]
    return np.stack([source.read(np.s_[x, :, -depths:]).max(axis=-1) for x in range(source.values.shape[0])])


def _frame(source: VolumeExportSource) -> Volume:
    """Return a volume that has the file's axes and zero values, as coordinates for drawing projections."""
    lines = [
        first + step * np.arange(count)
        for first, step, count in zip(source.origin, source.spacing, source.values.shape, strict=True)
    ]
    x, *y, z = lines
    values = np.broadcast_to(np.zeros(1, np.float32), source.values.shape)
    return Volume(values, VoxelAxes(x, y[0] if y else None, z), source.spacing)
