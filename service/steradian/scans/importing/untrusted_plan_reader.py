"""Reader of the plan stored in a scan file, with validation."""

from __future__ import annotations

import json
from typing import Any, NoReturn

import h5py
import numpy as np

from steradian.core.exceptions import DamagedFile
from steradian.masks import Mask
from steradian.plans import ScanPlan
from steradian.scans.importing import untrusted

NUMBERS = {
    "pulse_rate": "pulse_rate_hz",
    "averages": "averages",
    "samples": "samples",
    "sampling_interval": "sampling_interval_s",
    "sound_speed": "sound_speed_m_s",
}
"""Fields of a plan and the attributes that repeat them beside its document."""


def read_plan(file: h5py.File) -> ScanPlan:
    """Read the plan, with its mask, from an open scan file.

    Raises
    ------
    DamagedFile
        When something is missing, refused, or said twice and differently.
    InvalidInput
        When a value is out of range.
    """
    stated = {field: _needed(file, "plan", name) for field, name in NUMBERS.items()}
    fields = _json(file, "plan", untrusted.text(file, "plan", "document"))
    if "plan/wavelengths" in file:
        fields["wavelengths"] = untrusted.array(file, "plan/wavelengths")
    fields["mask"] = read_mask(file)
    plan = ScanPlan.create(**fields)
    for field, value in stated.items():
        if getattr(plan, field) != value:
            raise DamagedFile(
                f"{untrusted.name_of(file)} states {field} = {value:g}, but its plan {getattr(plan, field):g}"
            )
    return plan


def read_mask(file: h5py.File) -> Mask:
    """Read the mask from an open scan file; raises like :func:`read_plan`."""
    arrangement = _json(file, "mask", untrusted.text(file, "mask", "arrangement", most=untrusted.MOST_TEXT))
    offset = untrusted.float_array_attribute(file, "mask", "offset_m", 2)
    mask = Mask.create(
        aperture=_needed(file, "mask", "aperture_m"),
        positions=untrusted.array(file, "mask/positions"),
        weights=untrusted.array(file, "mask/weights"),
        outline=untrusted.array(file, "mask/outline") if "mask/outline" in file else None,
        depth=untrusted.float_attribute(file, "mask", "depth_m"),
        arrangement=arrangement,
        offset=offset or (0.0, 0.0),
    )
    try:
        aims = mask.points_of_interest
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise DamagedFile(
            f"{untrusted.name_of(file)}: the mask's arrangement has no proper points of interest"
        ) from error
    if not np.isfinite(aims).all():
        raise DamagedFile(f"{untrusted.name_of(file)}: the mask's points of interest are not all finite")
    return mask


def _needed(file: h5py.File, place: str, name: str) -> float:
    value = untrusted.float_attribute(file, place, name)
    if value is None:
        raise DamagedFile(f"{untrusted.name_of(file)} has no attribute {name} of {place}")
    return value


def _json(file: h5py.File, place: str, said: str | None) -> dict[str, Any]:
    def refuse(word: str) -> NoReturn:
        raise ValueError(f"{word} is not a number")

    try:
        found = json.loads(said or "", parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise DamagedFile(f"{untrusted.name_of(file)}: {place} has no document in JSON: {error}") from error
    if not isinstance(found, dict):
        raise DamagedFile(f"{untrusted.name_of(file)}: the document of {place} is not a JSON object")
    return found
