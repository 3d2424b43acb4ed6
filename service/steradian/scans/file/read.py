"""Reader of complete and partial scan files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile
from steradian.masks.modes_from_lattice import imported_modes
from steradian.scans.file import schema
from steradian.scans.file.aline_metadata import ShotTable
from steradian.scans.file.arrangement_metadata import arrangement_of, centre_of
from steradian.scans.file.h5py_errors import reraise_as_damaged
from steradian.scans.file.locking import open_for_reading
from steradian.scans.file.measurement_order import ScanProgram
from steradian.scans.file.sensitivity import sensitivity_of
from steradian.scans.file.source_metadata import notes_of, read_origin
from steradian.scans.frames import Frame, frame_number
from steradian.scans.recording import Recording, ShotMetadata

if TYPE_CHECKING:
    import h5py


def list_frames(path: Path) -> tuple[Frame, ...]:
    """List the frames of a scan file, with excitation wavelengths and A-line counts.

    Raises
    ------
    DamagedFile
        When the file is truncated, of another kind or newer.
    """
    with reraise_as_damaged(path, "scan"), open_for_reading(path) as file:
        schema.check_format(path, file)
        course = ScanProgram.of_file(file)
        stored = np.asarray(file["alines/status"]).reshape(-1, course.points) == schema.STORED
        fired = np.asarray(file["alines/fire_time_s"]).reshape(stored.shape)
    times = [frame[those] for frame, those in zip(fired, stored, strict=True)]
    return tuple(
        Frame(number, light, len(shots), *((float(shots.min()), float(shots.max())) if len(shots) else ()))
        for number, (light, shots) in enumerate(zip(course.excitation, times, strict=True))
    )


def read_scan(path: Path, frame: int | list[int] | None = 0) -> Recording:
    """Read the stored A-lines of one or more frames of a scan file as a recording.

    The weights of a partial scan are those of its points, scaled to sum to the sensed area again.

    Parameters
    ----------
    path
        The scan file.
    frame
        Which frame, see :func:`list_frames`; most scans have only the first. None: the only one. Of several, the rows
        of one follow those of the other, and :attr:`Recording.points` tells which ones belong to one point.

    Raises
    ------
    InvalidInput
        When there is no such frame, or none is named of several.
    DamagedFile
        When the file is truncated, of another kind or newer, or holds no A-line.
    """
    with reraise_as_damaged(path, "scan"), open_for_reading(path) as file:
        schema.check_format(path, file)
        return _read(path, file, frame)


def _read(path: Path, file: h5py.File, wanted: int | list[int] | None) -> Recording:
    mask, plan = file["mask"], file["plan"]
    points = len(mask["weights"])
    frames = len(file["alines/status"]) // points
    numbers = [frame_number(each, frames) for each in (wanted if isinstance(wanted, list) else [wanted])]
    parts = [_rows_of(file, number, points) for number in numbers]
    stored, traces = (np.concatenate([part[n] for part in parts]) for n in (0, 1))
    rows = np.concatenate([part[0] + number * points for part, number in zip(parts, numbers, strict=True)])
    table = ShotTable.joined([part[2] for part in parts])
    if not len(stored):
        raise DamagedFile(f"{path} holds no A-line yet")
    aperture, arrangement = float(mask.attrs["aperture_m"]), arrangement_of(mask)
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
        grid=imported_modes(np.asarray(mask["positions"], np.float64), aperture, arrangement),
        centre=centre_of(arrangement, mask["positions"].shape[1]),
        depth=float(mask.attrs["depth_m"]) if "depth_m" in mask.attrs else None,
        planned=points,
        outline=np.asarray(mask["outline"], np.float64) if "outline" in mask else None,
        missing=np.delete(np.asarray(mask["positions"], dtype=np.float64), np.unique(stored), axis=0),
        points=stored if len(numbers) > 1 else None,
        rows=rows,
        notes=notes_of(read_origin(file)),
        offset=tuple(map(float, mask.attrs.get("offset_m", (0.0, 0.0)))),
        provenance={
            "scan_id": str(file.attrs["scan_id"]),
            "plan_id": str(plan.attrs["id"]),
            "mask_id": str(mask.attrs["id"]),
            "scanner": str(file.attrs["scanner"]),
            "simulated": str(bool(file.attrs["simulated"])),
            **({"film": str(file.attrs["film"])} if "film" in file.attrs else {}),
            **({"beams": str(len(plan["beams"]))} if "beams" in plan else {}),
            **_frame_provenance(file, numbers, frames),
        },
        shots=replace(shots_of(table), sensitivity=sensitivity_of(file, table, stored)),
        times=shot_times(table, float(plan.attrs["pulse_rate_hz"])) if len(numbers) == 1 else None,
    )


def _rows_of(file: h5py.File, frame: int, points: int) -> tuple[NDArray[np.int64], NDArray[Any], ShotTable]:
    """Return the stored, intact rows of a frame: their points (n,), samples (n, N_t) and metadata columns."""
    rows = slice(frame * points, (frame + 1) * points)
    table = ShotTable.of_file(file, rows)
    stored = np.flatnonzero(table.stored)
    traces, table = np.asarray(file["alines/samples"][rows])[stored], table.take(stored)
    whole = table.verify_rows(traces)  # a power cut may leave a row that was never acknowledged half written
    return stored[whole], traces[whole], table.take(whole)


def shot_times(table: ShotTable, pulse_rate: float) -> NDArray[np.float64] | None:
    """Return the time of each A-line's shot (n,) in s since the first one.

    From the times at which the scanner fired, else from the numbers of the shots and the pulse rate in Hz; None where
    the file has neither, as imported recordings.
    """
    fired, numbers = table["fire_time_s"].astype(np.float64), table["shot"].astype(np.float64)
    if len(fired) and np.ptp(fired) > 0:
        return np.asarray(fired - fired.min())
    if len(numbers) and np.ptp(numbers) > 0 and pulse_rate > 0:
        return np.asarray((numbers - numbers.min()) / pulse_rate)
    return None


def shots_of(table: ShotTable) -> ShotMetadata:
    """Return the per-A-line metadata of rows of a scan file."""
    return ShotMetadata(
        energy=table["energy"].astype(np.float64),
        time_zero=table["time_zero_s"].astype(np.float64),
        quality=table["quality"],
        averages=table["averages"],
        level=table["dc_v"].astype(np.float64),
        gain=table["gain_db"].astype(np.float64),
    )


def _frame_provenance(file: h5py.File, numbers: list[int], frames: int) -> dict[str, str]:
    lights = {float(file["plan/frame_excitation"][number]) for number in numbers}
    told = {"excitation": ", ".join(f"{1e9 * light:g} nm" for light in sorted(lights))} if all(lights) else {}
    return told | ({"frame": f"{', '.join(map(str, numbers))} of {frames}"} if frames > 1 else {})
