"""Reader of the plan, mask and A-line counts in a scan file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from steradian.plans import ScanPlan
from steradian.scans.file import schema
from steradian.scans.file.h5py_errors import reraise_as_damaged
from steradian.scans.file.locking import open_for_reading
from steradian.scans.file.source_metadata import notes_of, read_origin
from steradian.scans.importing.untrusted_plan_reader import read_plan


@dataclass(frozen=True)
class StoredPlan:
    """Plan, A-line counts and import notes read from a scan file.

    Attributes
    ----------
    plan
        With its mask.
    simulated
        Whether its A-lines are no measurement.
    summary
        ``points`` planned, ``stored`` A-lines and ``fired`` shots.
    notes
        What was decided or assumed when it was imported.
    """

    plan: ScanPlan
    simulated: bool
    summary: dict[str, Any]
    notes: list[str]


def read_stored_plan(path: Path) -> StoredPlan:
    """Read plan, mask, A-line counts and import notes from a scan file.

    Raises
    ------
    DamagedFile
        When it cannot be read.
    InvalidInput
        When a value in it is out of range.
    """
    with reraise_as_damaged(path.name, "scan"), open_for_reading(path) as file:
        stored = int((np.asarray(file["alines/status"]) == schema.STORED).sum())
        summary = {"points": len(file["alines/status"]), "stored": stored, "fired": int(file["fired"][()])}
        return StoredPlan(read_plan(file), bool(file.attrs["simulated"]), summary, list(notes_of(read_origin(file))))
