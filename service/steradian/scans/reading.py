"""Reading scan files, finished or not."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np

from steradian.errors import DamagedFile, InvalidInput
from steradian.scans import schema
from steradian.scans.broken import reading
from steradian.scans.course import Course
from steradian.scans.locking import open_to_read
from steradian.scans.origin import notes_of, read_origin
from steradian.scans.recording import Recording, Shots
from steradian.scans.rows import RowTable
from steradian.scans.sensitivity import sensitivity_of


@dataclass(frozen=True)
class Frame:
    """One frame of a scan: an A-line at every point of the mask.

    Attributes
    ----------
    index
        From 0, in the order of measurement.
    excitation
        Excitation wavelength in m; 0: as the laser stood.
    stored
        A-lines measured so far.
    first_shot, last_shot
        When the scanner fired for its first and last A-line, in s since the scanner's boot; ``None`` before.
    """

    index: int
    excitation: float
    stored: int
    first_shot: float | None = None
    last_shot: float | None = None


def list_frames(path: Path) -> tuple[Frame, ...]:
    """List the frames of a scan file.

    Raises
    ------
    DamagedFile
        When the file is truncated, of another kind or newer.
    """
    with reading(path, "scan"), open_to_read(path) as file:
        _check_kind(path, file)
        course = Course.of_file(file)
        stored = np.asarray(file["alines/status"]).reshape(-1, course.points) == schema.STORED
        fired = np.asarray(file["alines/fire_time_s"]).reshape(stored.shape)
    times = [frame[those] for frame, those in zip(fired, stored, strict=True)]
    return tuple(
        Frame(number, light, len(shots), *((float(shots.min()), float(shots.max())) if len(shots) else ()))
        for number, (light, shots) in enumerate(zip(course.excitation, times, strict=True))
    )


def read_scan(path: Path, frame: int | None = 0) -> Recording:
    """Read the stored A-lines of one frame of a scan file; points not measured yet are left out.

    The weights of a partial scan are those of its points, scaled to sum to the sensed area again.

    Parameters
    ----------
    path
        The scan file.
    frame
        Which frame, see :func:`list_frames`; most scans have only the first. None: the only one.

    Raises
    ------
    InvalidInput
        When there is no such frame, or none is named of several.
    DamagedFile
        When the file is truncated, of another kind or newer, or holds no A-line.
    """
    with reading(path, "scan"), open_to_read(path) as file:
        _check_kind(path, file)
        return _read(path, file, frame)


def _check_kind(path: Path, file: h5py.File) -> None:
    kind, version = file.attrs.get("format"), file.attrs.get("schema_version")
    if kind != schema.FORMAT:
        raise DamagedFile(f"{path} is an HDF5 file, but its format is {kind!r}; expected {schema.FORMAT!r}")
    if version not in schema.READABLE:
        allowed = ", ".join(str(number) for number in schema.READABLE)
        raise DamagedFile(f"{path} has schema version {version}; this program reads {allowed}")


def _read(path: Path, file: h5py.File, wanted: int | None) -> Recording:
    alines, mask, plan = file["alines"], file["mask"], file["plan"]
    points = len(mask["weights"])
    frames = len(alines["status"]) // points
    frame = _number(wanted, frames)
    rows = slice(frame * points, (frame + 1) * points)
    table = RowTable.of_file(file, rows)
    stored = np.flatnonzero(table.stored)
    traces, table = np.asarray(alines["samples"][rows])[stored], table.take(stored)
    whole = table.intact(traces)  # a power cut may leave a row that was never acknowledged half written
    stored, traces, table = stored[whole], traces[whole], table.take(whole)
    if not len(stored):
        raise DamagedFile(f"{path} holds no A-line yet")
    aperture = float(mask.attrs["aperture_m"])
    weights = np.asarray(mask["weights"], dtype=np.float64)
    area = weights.sum()
    return Recording(
        traces=traces,
        scale=table["scale"],
        positions=np.asarray(mask["positions"], dtype=np.float64)[stored],
        weights=weights[stored] * (area / weights[stored].sum()),
        sampling_interval=float(plan.attrs["sampling_interval_s"]),
        sound_speed=float(plan.attrs["sound_speed_m_s"]),
        aperture=aperture,
        time_zero=float(table["time_zero_s"].min()),
        grid=None,
        depth=float(mask.attrs["depth_m"]) if "depth_m" in mask.attrs else None,
        planned=points,
        outline=np.asarray(mask["outline"], np.float64) if "outline" in mask else None,
        missing=np.delete(np.asarray(mask["positions"], dtype=np.float64), stored, axis=0),
        notes=notes_of(read_origin(file)),
        offset=tuple(map(float, mask.attrs.get("offset_m", (0.0, 0.0)))),
        provenance={
            "scan_id": str(file.attrs["scan_id"]),
            "plan_id": str(plan.attrs["id"]),
            "mask_id": str(mask.attrs["id"]),
            "scanner": str(file.attrs["scanner"]),
            "simulated": str(bool(file.attrs["simulated"])),
            **({"beams": str(len(plan["beams"]))} if "beams" in plan else {}),
            **_frame_provenance(file, frame, frames),
        },
        shots=replace(shots_of(table), sensitivity=sensitivity_of(file, table, stored)),
    )


def shots_of(table: RowTable) -> Shots:
    """Return what a scan file's rows say about each A-line."""
    return Shots(
        energy=table["energy"].astype(np.float64),
        time_zero=table["time_zero_s"].astype(np.float64),
        quality=table["quality"],
        averages=table["averages"],
        level=table["dc_v"].astype(np.float64),
        gain=table["gain_db"].astype(np.float64),
    )


def _number(frame: int | None, frames: int) -> int:
    """Return the number of a frame; None is the only one."""
    if frame is None and frames == 1:
        return 0
    if isinstance(frame, bool) or not isinstance(frame, int | np.integer) or not 0 <= frame < frames:
        allowed = f"a whole number, 0 to {frames - 1}" if frames > 1 else "0, or None: the scan has one frame"
        raise InvalidInput("frame", frame, allowed)
    return int(frame)


def _frame_provenance(file: h5py.File, frame: int, frames: int) -> dict[str, str]:
    if frames == 1 and "frame_excitation" not in file["plan"]:
        return {}
    excitation = float(file["plan/frame_excitation"][frame])
    told = {"excitation": f"{1e9 * excitation:g} nm"} if excitation else {}
    return told | ({"frame": f"{frame} of {frames}"} if frames > 1 else {})
