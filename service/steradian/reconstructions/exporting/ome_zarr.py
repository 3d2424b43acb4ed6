"""Export of volumes as OME-Zarr 0.4 (folder of compressed chunks), for napari, Fiji and web viewers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from steradian._version import __version__
from steradian.reconstructions.exporting.optional_imports import import_optional
from steradian.reconstructions.exporting.source import VolumeExportSource

CHUNK_SIDE = 128


def write_ome_zarr(source: VolumeExportSource, path: Path) -> None:
    """Write a volume as OME-Zarr 0.4 (Zarr 2) in micrometres, axes z, y, x, at full resolution.

    Raises
    ------
    InvalidInput
        When zarr is not installed.
    """
    zarr = import_optional("zarr", "ome-zarr")
    shape = source.shape[::-1]
    # the path itself: zarr 3.4 reads a text with ? or # as a URL
    group = zarr.open_group(path, mode="w", zarr_format=2)
    array = group.create_array(
        "0",
        shape=shape,
        dtype=source.dtype,
        chunks=tuple(min(CHUNK_SIDE, side) for side in shape),
        chunk_key_encoding={"name": "v2", "separator": "/"},
    )
    start = 0
    for slab in source.depth_slabs():
        array[start : start + len(slab)] = slab
        start += len(slab)
    group.attrs.update(_attributes(source))


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
