"""Arrangement of a scan file's mask, and the coordinate frame of the file that its positions came from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import h5py


def arrangement_of(mask: h5py.Group) -> dict[str, Any]:
    """Return the arrangement that a scan file's mask states; an empty one where it states none."""
    said = json.loads(mask.attrs.get("arrangement", "{}"))
    return said if isinstance(said, dict) else {}


def centre_of(arrangement: Mapping[str, Any], axes: int) -> tuple[float, ...]:
    """Return the coordinates in m of the aperture's centre in the source's frame, one an axis; () where there is none.

    A file of another program may state anything there.
    """
    centre = arrangement.get("centre_m")
    if not isinstance(centre, list) or len(centre) != axes or not all(isinstance(each, int | float) for each in centre):
        return ()
    return tuple(map(float, centre)) if any(centre) else ()
