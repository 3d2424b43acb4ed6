"""Virtual OME-Zarr 0.5 store on top of a volume file.

The file's chunks are [x, y, z], as are its values; Zarr's axes are z, y, x, as viewers expect, by the codec
*transpose*.
"""

from __future__ import annotations

import json
import re
from typing import Any, Final

from steradian.reconstructions.volumes.grid import VoxelGrid
from steradian.reconstructions.volumes.reader import VolumeReader

METADATA: Final = "zarr.json"
_ARRAY: Final = re.compile(r"(0|[1-9][0-9]?)/(zarr\.json|c((?:/(?:0|[1-9][0-9]{0,8}))+))")
_MICROMETRES: Final = 1e6


def get_node(stored: VolumeReader, path: str) -> bytes | None:
    """Return the Zarr node (metadata or chunk) at a path of the store; ``None`` if it does not exist.

    Raises
    ------
    DamagedFile
        When the file ends before the values.
    """
    if path == METADATA:
        return _json({"zarr_format": 3, "node_type": "group", "attributes": {"ome": _multiscales(stored)}})
    found = _ARRAY.fullmatch(path)
    if found is None or int(found[1]) > stored.levels:
        return None
    values = stored.level(int(found[1]))
    if found[2] == METADATA:
        return _json(_array(stored, int(found[1])))
    numbers = tuple(int(number) for number in reversed(found[3].split("/")[1:]))
    return values.chunk(numbers) if numbers in values.places else None


def _json(about: dict[str, Any]) -> bytes:
    return json.dumps(about, allow_nan=False).encode()


def _array(stored: VolumeReader, level: int) -> dict[str, Any]:
    values, names = stored.level(level), stored.lattice.names
    order = list(range(len(names)))[::-1]
    return {
        "zarr_format": 3,
        "node_type": "array",
        "shape": values.shape[::-1],
        "data_type": values.dtype.name,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": values.chunks[::-1]}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": 0.0,
        "codecs": [
            {"name": "transpose", "configuration": {"order": order}},
            {"name": "bytes", "configuration": {"endian": "big" if values.dtype.str[0] == ">" else "little"}},
        ],
        "attributes": {},
        "dimension_names": names[::-1],
    }


def _multiscales(stored: VolumeReader) -> dict[str, Any]:
    lattice = stored.lattice.moved(stored.centre)
    return {
        "version": "0.5",
        "multiscales": [
            {
                "name": "initial pressure",
                "type": "mean",
                "axes": [{"name": name, "type": "space", "unit": "micrometer"} for name in stored.lattice.names[::-1]],
                "datasets": [
                    {
                        "path": str(level),
                        "coordinateTransformations": _transformations(lattice.downsampled(2**level)),
                    }
                    for level in range(stored.levels + 1)
                ],
            }
        ],
    }


def _transformations(lattice: VoxelGrid) -> list[dict[str, Any]]:
    """Return the OME-Zarr coordinate transformations (voxel size and origin) in micrometres."""
    scale, translation = ([_MICROMETRES * one for one in line[::-1]] for line in (lattice.spacing, lattice.origin))
    return [{"type": "scale", "scale": scale}, {"type": "translation", "translation": translation}]
