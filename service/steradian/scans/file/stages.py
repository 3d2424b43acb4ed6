"""Stages of a scan file: their records, and the extension of a file by the points of the next stage.

A scan file never changes its size. The file of the next stage is therefore a new one, which has the A-lines measured so
far in the rows of the same points and frames, and replaces the earlier one by a rename: at every moment the path holds
one whole file, either without the stage or with it.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import TypeAdapter

from steradian.core.atomic_files import DRAFT_SUFFIX, sync_folder
from steradian.core.exceptions import InvalidInput
from steradian.plans import ScanPlan
from steradian.plans.stages import StageRecord
from steradian.scans.file import schema
from steradian.scans.file.create import create_scan_file
from steradian.scans.file.h5py_errors import reraise_as_damaged
from steradian.scans.file.locking import lock, open_for_reading

if TYPE_CHECKING:
    import h5py

ATTRIBUTE = "stages"
"""Attribute of the plan that holds the records as JSON."""
_OF_THE_FILE = frozenset({"geometry_crc32c", "tuning_map"})
"""Attributes of a file that follow from its plan."""
_RECORDS = TypeAdapter(tuple[StageRecord, ...])


def read_stages(path: Path) -> tuple[StageRecord, ...]:
    """Return the records of a scan file's stages, first the survey; empty for a scan of one stage.

    Raises
    ------
    DamagedFile
        When the file is of another kind, or its records cannot be read.
    """
    with reraise_as_damaged(path, "scan"), open_for_reading(path) as file:
        schema.check_format(path, file)
        return stages_of(file)


def stages_of(file: h5py.File) -> tuple[StageRecord, ...]:
    """Return the records of an open scan file's stages."""
    said = file["plan"].attrs.get(ATTRIBUTE)
    return () if said is None else _RECORDS.validate_json(said)


def expects_further_stages(file: h5py.File) -> bool:
    """Return whether the plan of an open scan file has stages whose points are not in the file yet."""
    return bool(json.loads(file["plan"].attrs["document"]).get("stages"))


def extend_scan_file(path: Path, plan: ScanPlan, stage: StageRecord) -> None:
    """Replace a scan file by one with the points of the next stage and all A-lines measured so far.

    Parameters
    ----------
    path
        Scan file of the stages before, which no other process writes to.
    plan
        Plan of the next stage; its mask begins with the points of the file.
    stage
        Record of the new stage.

    Raises
    ------
    Conflict
        When another process writes to the file.
    DiskFull
        When the disk cannot hold the larger file; the earlier one stays as it is.
    InvalidInput
        When the plan's mask does not begin with the file's points.
    """
    draft = path.with_name(f"{path.name}.stage{DRAFT_SUFFIX}")
    draft.unlink(missing_ok=True)
    try:
        with path.open("r+b", buffering=0) as locked:
            lock(locked.fileno(), path)
            with reraise_as_damaged(path, "scan"), open_for_reading(path) as before:
                _create(draft, before, plan)
                _copy_alines(draft, before, plan, stage)
            with draft.open("rb") as raw:
                os.fsync(raw.fileno())
            draft.replace(path)
        sync_folder(path.parent)
    finally:
        draft.unlink(missing_ok=True)


def _create(draft: Path, before: h5py.File, plan: ScanPlan) -> None:
    count = len(before["mask/positions"])
    if not np.array_equal(before["mask/positions"], plan.mask.positions[:count]):
        raise InvalidInput("mask", "points elsewhere", "the points of the scan, then further ones")
    later = plan.visit[plan.visit >= count]
    create_scan_file(
        draft,
        plan,
        scan_id=str(before.attrs["scan_id"]),
        time_zero=float(before["plan"].attrs["time_zero_s"]),
        visit=np.concatenate([np.asarray(before["plan/visit"], np.int64), later]),
    )


def _copy_alines(draft: Path, before: h5py.File, plan: ScanPlan, stage: StageRecord) -> None:
    """Copy A-lines, counts and attributes into a new file, frame by frame."""
    import h5py

    records = stages_of(before) or (first_stage(before),)
    count, frames = len(before["mask/positions"]), plan.frame_count
    with h5py.File(draft, "r+") as file:
        file.attrs.update({name: value for name, value in before.attrs.items() if name not in _OF_THE_FILE})
        for name, column in before["alines"].items():
            file["alines"][name].attrs.update(column.attrs)
            for frame in range(frames):
                rows = column[frame * count : (frame + 1) * count]
                file["alines"][name][frame * plan.mask.count : frame * plan.mask.count + count] = rows
        file["run/reference"][...] = before["run/reference"][...]
        file["fired"][...] = before["fired"][...]
        file["plan"].attrs[ATTRIBUTE] = _RECORDS.dump_json((*records, stage)).decode()


def first_stage(file: h5py.File) -> StageRecord:
    """Return the record of the survey of a scan file that has no further stage yet."""
    return StageRecord(number=1, points=len(file["mask/positions"]), plan_id=str(file["plan"].attrs["id"]))
