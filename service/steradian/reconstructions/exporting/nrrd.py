"""Export of volumes as NRRD (text header and raw numbers), for 3D Slicer, ITK and VTK."""

from __future__ import annotations

from pathlib import Path

from steradian._version import __version__
from steradian.reconstructions.exporting.source import VolumeExportSource

KINDS = {"f4": "float", "f8": "double"}


def write_nrrd(source: VolumeExportSource, path: Path) -> None:
    """Write a volume as NRRD in millimetres, x fastest; depth z points to the file's superior."""
    spacing, origin = ([1e3 * value for value in values] for values in (source.spacing_xyz, source.origin_xyz))
    directions = [[step if row == column else 0.0 for column in range(3)] for row, step in enumerate(spacing)]
    header = [
        "NRRD0005",
        f"# initial pressure, written by steradian {__version__}",
        *(f"# {' '.join(text.split())}" for text in (source.parameters, source.provenance)),
        f"type: {KINDS[source.dtype.str[1:]]}",
        "dimension: 3",
        "space: right-anterior-superior",
        f"sizes: {' '.join(map(str, source.shape))}",
        f"space directions: {' '.join(_vector(direction) for direction in directions)}",
        "kinds: domain domain domain",
        'labels: "x" "y" "z"',
        'space units: "mm" "mm" "mm"',
        "endian: little",
        "encoding: raw",
        f"space origin: {_vector(origin)}",
    ]
    with path.open("wb") as file:
        file.write(("\n".join(header) + "\n\n").encode("ascii", "backslashreplace"))
        for slab in source.depth_slabs():
            file.write(slab.tobytes())


def _vector(values: list[float]) -> str:
    return "(" + ",".join(f"{value:.17g}" for value in values) + ")"
