"""Regions of interest as JSON and as text.

A file of regions::

    {"format": "steradian-regions", "version": 1, "background": "beside", "regions": [
      {"kind": "box", "name": "vessel", "ranges": [[-2e-4, 2e-4], [-1e-3, 1e-3], [1.9e-3, 2.1e-3]]},
      {"kind": "ellipsoid", "name": "tumour", "centre": [0, 0, 2e-3], "radii": [1e-3, 1e-3, 5e-4]},
      {"kind": "polygon", "name": "beside", "axis": "z", "corners": [[0, 0], [1e-3, 0], [0, 1e-3]],
       "along": [1e-3, 2e-3]},
      {"kind": "above-threshold", "name": "bright", "share": 0.5, "within": {"kind": "box", …}}]}

Lengths are in metres.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound
from steradian.quality.region_statistics import AboveThreshold, Box, Ellipsoid, Polygon, RegionOfInterest

FORMAT, VERSION = "steradian-regions", 1
KINDS = ("box", "ellipsoid", "polygon", "above-threshold")
TEXTS = (
    "box NAME x0:x1,y0:y1,z0:z1; ellipsoid NAME x,y,z rx,ry,rz; polygon NAME z x,y;x,y;x,y z0:z1; "
    "any of them after 'above SHARE' (lengths in mm)"
)
MOST_CORNERS = 1000
DEEPEST = 8
"""Most thresholds within each other."""


def region_to_json(region: RegionOfInterest) -> dict[str, Any]:
    """Return a region as a JSON object; raises :class:`TypeError` for a region of another kind."""
    if isinstance(region, Box):
        return {"kind": "box", "name": region.name, "ranges": [list(each) for each in region.ranges]}
    if isinstance(region, Ellipsoid):
        centre, radii = list(region.centre), list(region.radii)
        return {"kind": "ellipsoid", "name": region.name, "centre": centre, "radii": radii}
    if isinstance(region, Polygon):
        corners = [list(each) for each in region.corners]
        about = {"axis": region.axis, "corners": corners, "along": list(region.along)}
        return {"kind": "polygon", "name": region.name} | about
    if isinstance(region, AboveThreshold):
        within = region_to_json(region.within)
        return {"kind": "above-threshold", "name": region.name, "share": region.share, "within": within}
    raise TypeError(f"a {type(region).__name__} is not one of {', '.join(KINDS)}")


def region_from_json(said: Mapping[str, Any], *, depth: int = 0) -> RegionOfInterest:
    """Return the region of a JSON object.

    Raises
    ------
    InvalidInput
        If a field is missing, unknown or out of range.
    """
    kind, name = said.get("kind"), said.get("name")
    if kind not in KINDS:
        raise InvalidInput("region.kind", kind, ", ".join(KINDS))
    if not isinstance(name, str) or not 1 <= len(name) <= 100:
        raise InvalidInput("region.name", name, "a text of 1 to 100 characters")
    try:
        if kind == "box":
            return Box(name, tuple(_pair(each) for each in said["ranges"]))
        if kind == "ellipsoid":
            return Ellipsoid(name, tuple(map(float, said["centre"])), tuple(map(float, said["radii"])))
        if kind == "polygon":
            if len(said["corners"]) > MOST_CORNERS:
                raise InvalidInput("region.corners", len(said["corners"]), f"at most {MOST_CORNERS}")
            corners = tuple(_pair(each) for each in said["corners"])
            return Polygon(name, str(said["axis"]), corners, _pair(said["along"]))
        if depth >= DEEPEST:
            raise InvalidInput("region.within", f"{depth} within each other", f"at most {DEEPEST}")
        return AboveThreshold(name, region_from_json(said["within"], depth=depth + 1), float(said["share"]))
    except InvalidInput:
        raise
    except KeyError as error:
        raise InvalidInput(f"region.{error.args[0]}", "missing", f"given for a {kind}") from None
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InvalidInput(f"region {name}", str(error), f"numbers in metres, as a {kind} has them") from None


def read_regions(path: Path) -> tuple[list[RegionOfInterest], RegionOfInterest | None]:
    """Read a file of regions; return the regions without the background, and the background or None.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is not a file of regions.
    InvalidInput
        When a region is out of range, or the background is none of them.
    """
    if not path.is_file():
        raise NotFound("file", str(path))
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise DamagedFile(f"{path} is not JSON: {error}") from error
    if not isinstance(said, dict) or said.get("format") != FORMAT or said.get("version") != VERSION:
        raise DamagedFile(f"{path} is not a file of regions: format {FORMAT!r}, version {VERSION}")
    regions = [region_from_json(each) for each in said.get("regions", ())]
    name = said.get("background")
    if name is None:
        return regions, None
    for region in regions:
        if region.name == name:
            return [each for each in regions if each is not region], region
    raise InvalidInput("background", name, ", ".join(each.name for each in regions) or "none: there are no regions")


def write_regions(path: Path, regions: Sequence[RegionOfInterest], background: RegionOfInterest | None = None) -> None:
    """Write regions and the background to a file by an atomic write, for :func:`read_regions`."""
    every = [*regions, *([] if background is None else [background])]
    said = {"format": FORMAT, "version": VERSION, "background": None if background is None else background.name}
    with atomic_write(path) as beside:
        text = json.dumps(said | {"regions": [region_to_json(each) for each in every]}, indent=1)
        beside.write_text(text + "\n", encoding="utf-8")


def region_from_text(text: str) -> RegionOfInterest:
    """Return the region of a text such as ``box vessel -0.2:0.2,-1:1,1.9:2.1``, in millimetres.

    Raises
    ------
    InvalidInput
        If the text is none of the forms.
    """
    words = text.split()
    try:
        if words[0] == "above":
            within = region_from_text(" ".join(words[2:]))
            return AboveThreshold(within.name, within, float(words[1]))
        kind, name, *rest = words
        if kind == "box" and len(rest) == 1:
            return Box(name, tuple(_span(each) for each in rest[0].split(",")))
        if kind == "ellipsoid" and len(rest) == 2:
            return Ellipsoid(name, _lengths(rest[0]), _lengths(rest[1]))
        if kind == "polygon" and len(rest) == 3:
            corners = tuple(_pair(_lengths(each)) for each in rest[1].split(";"))
            return Polygon(name, rest[0], corners, _span(rest[2]))
    except (ValueError, IndexError):
        pass
    raise InvalidInput("region", text, TEXTS)


def _pair(values: Sequence[Any]) -> tuple[float, float]:
    first, second = map(float, values)
    return first, second


def _lengths(text: str) -> tuple[float, ...]:
    return tuple(1e-3 * float(part) for part in text.split(","))


def _span(text: str) -> tuple[float, float]:
    first, last = text.split(":")
    return 1e-3 * float(first), 1e-3 * float(last)
