"""What a scan file of our own says of its plan: an imported recording needs a mask and a plan like any other scan."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from steradian.errors import DamagedFile
from steradian.masks import Mask
from steradian.plans import ScanPlan
from steradian.scans import schema


@dataclass(frozen=True)
class Imported:
    """What the file says.

    Attributes
    ----------
    plan
        With its mask.
    simulated
        Whether its A-lines are no measurement.
    summary
        ``points`` planned, ``stored`` A-lines and ``fired`` shots.
    """

    plan: ScanPlan
    simulated: bool
    summary: dict[str, Any]


def read_imported(path: Path) -> Imported:
    """Read the plan, with its mask, from a scan file.

    Raises
    ------
    DamagedFile
        When it cannot be read.
    InvalidInput
        When a value in it is out of range.
    """
    try:
        with h5py.File(path, "r") as file:
            mask, plan = file["mask"], file["plan"]
            made = Mask.create(
                aperture=float(mask.attrs["aperture_m"]),
                positions=np.asarray(mask["positions"]),
                weights=np.asarray(mask["weights"]),
                depth=float(mask.attrs["depth_m"]) if "depth_m" in mask.attrs else None,
                arrangement=json.loads(mask.attrs["arrangement"]),
            )
            stored = int((np.asarray(file["alines/status"]) == schema.STORED).sum())
            summary = {"points": len(file["alines/status"]), "stored": stored, "fired": int(file["fired"][()])}
            about = {"wavelengths": np.asarray(plan["wavelengths"])} if "wavelengths" in plan else {}
            whole = ScanPlan.create(mask=made, **about, **_document(plan))
            return Imported(whole, bool(file.attrs["simulated"]), summary)
    except (OSError, KeyError, json.JSONDecodeError) as error:
        raise DamagedFile(f"{path} cannot be read as a scan: {error}") from error


def _document(plan: h5py.Group) -> dict[str, Any]:
    if "document" in plan.attrs:
        document: dict[str, Any] = json.loads(plan.attrs["document"])
        return document
    units = {"pulse_rate": "hz", "sampling_interval": "s", "sound_speed": "m_s"}
    numbers = {name: float(plan.attrs[f"{name}_{unit}"]) for name, unit in units.items()}
    counts = {name: int(plan.attrs[name]) for name in ("averages", "samples")}
    return numbers | counts | {"order": str(plan.attrs["order"])}
