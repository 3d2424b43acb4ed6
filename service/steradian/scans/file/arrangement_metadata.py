"""Arrangement metadata of a scan file's mask, and the offset to the coordinates of an imported source."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import h5py


def arrangement_of(mask: h5py.Group) -> dict[str, Any]:
    """Return the arrangement (parameters of the mask) stored in a scan file; empty if none is stored."""
    said = json.loads(mask.attrs.get("arrangement", "{}"))
    return said if isinstance(said, dict) else {}


def centre_of(arrangement: Mapping[str, Any], axes: int) -> tuple[float, ...]:
    """Return the aperture's centre in the coordinates of the imported source, in m per axis; () if unknown.

    A file of another program may state anything there.
    """
    centre = arrangement.get("centre_m")
    if not isinstance(centre, list) or len(centre) != axes or not all(isinstance(each, int | float) for each in centre):
        return ()
    return tuple(map(float, centre)) if any(centre) else ()
