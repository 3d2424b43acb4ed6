"""Export of volumes as OME-Zarr 0.4 (folder of compressed chunks), for napari, Fiji and web viewers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from steradian._version import __version__
from steradian.reconstructions.exporting.optional_imports import import_optional
from steradian.reconstructions.exporting.series_source import SeriesExportSource
from steradian.reconstructions.exporting.source import VolumeExportSource

CHUNK_SIDE = 128
COLOURS = ("FFFFFF", "FF4040", "40A0FF", "40FF60", "FFC020", "FF40FF", "40FFFF")
"""Colours of channels in viewers that mix them."""


def write_ome_zarr(source: VolumeExportSource, path: Path) -> None:
    """Write a volume as OME-Zarr 0.4 (Zarr 2) in micrometres, axes z, y, x, at full resolution.

    Raises
    ------
    InvalidInput
        When zarr is not installed.
    """
    zarr = import_optional("zarr", "ome-zarr")
    shape = source.shape[::-1]
    group, array = _created(zarr, path, shape, source)
    start = 0
    for slab in source.depth_slabs():
        array[start : start + len(slab)] = slab
        start += len(slab)
    group.attrs.update(_attributes(source))


def write_ome_zarr_series(source: SeriesExportSource, path: Path) -> None:
    """Write a series as OME-Zarr 0.4 with axes t, c, z, y, x: times and wavelengths, in s where intervals are even.

    A ragged series has axes c, z, y, x: a channel for each volume. Channels are called by wavelength; the times of all
    volumes are in the attributes ``steradian``.

    Raises
    ------
    InvalidInput
        When zarr is not installed.
    """
    zarr = import_optional("zarr", "ome-zarr")
    grid = source.grid
    outer = (len(grid), len(grid[0])) if source.is_regular else (len(grid[0]),)
    group, array = _created(zarr, path, (*outer, *source.first.shape[::-1]), source.first)
    highest = [0.0] * len(grid[0])
    for time, row in enumerate(grid):
        for channel, number in enumerate(row):
            start = 0
            for slab in source.volumes[number].depth_slabs():
                place = (time, channel) if source.is_regular else (channel,)
                array[(*place, slice(start, start + len(slab)))] = slab
                highest[channel] = max(highest[channel], float(np.nanmax(slab, initial=0.0)))
                start += len(slab)
    attributes = _attributes(source.first)
    image = attributes["multiscales"][0]
    clock = {"name": "t", "type": "time"} | ({"unit": "second"} if source.interval else {})
    front = [clock, {"name": "c", "type": "channel"}][-len(outer) :]
    image["axes"] = front + image["axes"]
    scale, translation = image["datasets"][0]["coordinateTransformations"]
    scale["scale"] = [source.interval or 1.0, 1.0][-len(outer) :] + scale["scale"]
    translation["translation"] = [0.0] * len(outer) + translation["translation"]
    attributes["omero"] = {
        "channels": [
            {
                "label": name,
                "color": COLOURS[number % len(COLOURS)],
                "active": number == 0,
                "window": {"min": 0.0, "max": most, "start": 0.0, "end": most},
            }
            for number, (name, most) in enumerate(zip(source.channel_names, highest, strict=True))
        ]
    }
    attributes["steradian"] |= {"frames": source.description(), "order": grid}
    group.attrs.update(attributes)


def _created(zarr: Any, path: Path, shape: tuple[int, ...], source: VolumeExportSource) -> tuple[Any, Any]:
    """Create the group and its array at full resolution; return both."""
    # the path itself: zarr 3.4 reads a text with ? or # as a URL
    group = zarr.open_group(path, mode="w", zarr_format=2)
    array = group.create_array(
        "0",
        shape=shape,
        dtype=source.dtype,
        chunks=(1,) * (len(shape) - 3) + tuple(min(CHUNK_SIDE, side) for side in shape[-3:]),
        chunk_key_encoding={"name": "v2", "separator": "/"},
    )
    return group, array


def _attributes(source: VolumeExportSource) -> dict[str, Any]:
    scale, translation = ([1e6 * value for value in values[::-1]] for values in (source.spacing_xyz, source.origin_xyz))
    return {
        "multiscales": [
            {
                "version": "0.4",
                "name": "initial pressure",
                "axes": [{"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"],
                "datasets": [
                    {
                        "path": "0",
                        "coordinateTransformations": [
                            {"type": "scale", "scale": scale},
                            {"type": "translation", "translation": translation},
                        ],
                    }
                ],
            }
        ],
        "steradian": {
            "software": f"steradian {__version__}",
            "parameters": json.loads(source.parameters),
            "provenance": json.loads(source.provenance),
        },
    }
