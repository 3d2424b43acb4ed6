"""Incremental reader (tail) of a scan file that another process is writing."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput, SteradianError
from steradian.masks.modes_from_lattice import imported_modes
from steradian.scans.file import schema
from steradian.scans.file.aline_metadata import ShotTable
from steradian.scans.file.arrangement_metadata import arrangement_of, centre_of
from steradian.scans.file.h5py_errors import reraise_as_damaged
from steradian.scans.file.locking import open_for_reading
from steradian.scans.file.read import list_frames, shots_of
from steradian.scans.file.sensitivity import sensitivity_of
from steradian.scans.file.stages import expects_further_stages
from steradian.scans.recording import Recording, ShotMetadata

if TYPE_CHECKING:
    import h5py

_GAP = 16  # rows not wanted that are rather read than skipped


@dataclass(frozen=True)
class AlineBatch:
    """A-lines stored since the previous read.

    Attributes
    ----------
    points
        (K,) points of the mask, rising.
    traces
        (K, N_t) float32 pressures.
    shots
        What differed from A-line to A-line.
    replaced
        Whether this batch replaces all earlier ones and has every stored A-line. The reason is an A-line measured
        again, or the first pulse energy, which changes the meaning of A-lines without one.
    energy_known
        Whether any A-line stored so far, in this or an earlier batch, has a pulse energy.
    """

    points: NDArray[np.int64]
    traces: NDArray[np.float32]
    replaced: bool
    shots: ShotMetadata
    energy_known: bool


class ScanExtended(SteradianError):
    """Error: the scan file has been replaced by one with the points of a further stage."""

    code = "conflict"


class ScanTail:
    """Reader of the rows added to a scan file since the previous read.

    Parameters
    ----------
    path
        A scan file, finished or not; each read reopens it, because another process writes to it.
    frame
        Which frame of it.

    Attributes
    ----------
    whole
        The frame as planned: all points with the mask's weights; its ``traces`` are zeros. Its time zero is the
        earliest of the A-lines stored by now, the plan's where there is none.

    Raises
    ------
    DamagedFile
        When the file is of another kind or newer.
    InvalidInput
        When the scan has no such frame.
    """

    def __init__(self, path: Path, frame: int = 0) -> None:
        self.path = path
        with reraise_as_damaged(path, "scan"), open_for_reading(path) as file:
            schema.check_format(path, file)
            points = len(file["mask/weights"])
            frames = len(file["alines/status"]) // points
            if not 0 <= frame < frames:
                raise InvalidInput("frame", frame, f"0 to {frames - 1}")
            self.whole = _planned(file, slice(frame * points, (frame + 1) * points))
        self._first = frame * self.whole.planned
        self._seen = np.zeros(self.whole.planned, bool)
        self._checksums = np.zeros(self.whole.planned, np.uint32)
        self._energy_known = False

    def read_new(self, most: int | None = None) -> AlineBatch:
        """Read the A-lines stored since the previous call.

        A row that does not match its checksum (it is being written again this moment) is left for the next call.

        Parameters
        ----------
        most
            How many at most; the others are left for the next call. None: all.

        Raises
        ------
        ScanExtended
            When the scan has got a further stage: its points are others, and a new reader is needed.
        DamagedFile
            When the file cannot be read any more.
        """
        with reraise_as_damaged(self.path, "scan"), open_for_reading(self.path) as file:
            return self._take(file, most)

    def rewind(self) -> None:
        """Reset the reader, so that the next call reads all A-lines."""
        self._seen[:] = False

    def _take(self, file: h5py.File, most: int | None) -> AlineBatch:
        if len(file["mask/weights"]) != self.whole.planned:
            raise ScanExtended(f"{self.path} has a further stage: open it again")
        rows = slice(self._first, self._first + self.whole.planned)
        table = ShotTable.of_file(file, rows)
        stored, checksums = table.stored, table["crc32c"]
        changed = ~stored | (checksums != self._checksums)
        known, before = bool(table["energy"][stored].any()), self._energy_known
        replaced = bool((self._seen & (changed | (known != before))).any())
        self._energy_known = known
        if replaced:
            self.rewind()
        points = np.flatnonzero(stored & ~self._seen)[:most]
        samples = _read_rows(file["alines/samples"], self._first + points)
        table = table.take(points)
        whole = table.verify_rows(samples)
        points, samples, table = points[whole], samples[whole], table.take(whole)
        self._seen[points] = True
        self._checksums[points] = checksums[points]
        traces = np.multiply(samples, table["scale"][:, None], dtype=np.float32)
        shots = replace(shots_of(table), sensitivity=sensitivity_of(file, table, points))
        return AlineBatch(points, traces, replaced, shots, known)


def has_alines(path: Path, frame: int = 0) -> bool:
    """Return whether a scan file exists and has an A-line in a frame; also True if the frame does not exist."""
    if not path.is_file():
        return False
    frames = list_frames(path)
    return not 0 <= frame < len(frames) or frames[frame].stored > 0


class IdleDetector:
    """Detector of the end of a scan written by another process.

    All A-lines are stored, or none was added for a given time.

    Parameters
    ----------
    path
        The scan file; it need not exist yet.
    patience
        Seconds without a new A-line after which the scan counts as over.
    clock
        Seconds that never go back.
    """

    def __init__(self, path: Path, patience: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._path, self._patience, self._clock = path, patience, clock
        self._stored, self._since = -1, clock()

    def __call__(self) -> bool:
        """Return whether the scan is over: complete, or without a new A-line for ``patience`` seconds."""
        stored, rows = self._count()
        if stored != self._stored:
            self._stored, self._since = stored, self._clock()
        return stored == rows or self._clock() - self._since > self._patience

    def _count(self) -> tuple[int, int]:
        """Return the numbers of stored and planned A-lines; (-1, 0) if the file does not exist yet.

        One more is planned where a further stage is to come.
        """
        if not self._path.is_file():
            return -1, 0
        with reraise_as_damaged(self._path, "scan"), open_for_reading(self._path) as file:
            status = np.asarray(file["alines/status"])
            return int((status == schema.STORED).sum()), len(status) + expects_further_stages(file)


def _planned(file: h5py.File, rows: slice) -> Recording:
    """Return a recording with all planned points of a frame and zero samples."""
    table = ShotTable.of_file(file, rows)
    begun = table["time_zero_s"][table.stored]
    mask, plan = file["mask"], file["plan"]
    positions = np.asarray(mask["positions"], np.float64)
    count, samples = len(positions), file["alines/samples"].shape[1]
    return Recording(
        traces=np.broadcast_to(np.zeros(1, np.int16), (count, samples)),
        scale=1.0,
        positions=positions,
        weights=np.asarray(mask["weights"], np.float64),
        sampling_interval=float(plan.attrs["sampling_interval_s"]),
        sound_speed=float(plan.attrs["sound_speed_m_s"]),
        aperture=float(mask.attrs["aperture_m"]),
        time_zero=float(begun.min() if len(begun) else plan.attrs["time_zero_s"]),
        grid=imported_modes(positions, float(mask.attrs["aperture_m"]), arrangement_of(mask)),
        centre=centre_of(arrangement_of(mask), positions.shape[1]),
        depth=float(mask.attrs["depth_m"]) if "depth_m" in mask.attrs else None,
        planned=count,
        provenance={},
        outline=np.asarray(mask["outline"], np.float64) if "outline" in mask else None,
    )


def _read_rows(samples: h5py.Dataset, rows: NDArray[np.int64]) -> NDArray[Any]:
    """Read rows of a dataset in contiguous runs, because HDF5 reads lists of single rows slowly."""
    found: NDArray[Any] = np.empty((len(rows), samples.shape[1]), samples.dtype)
    if not len(rows):
        return found
    breaks = np.flatnonzero(np.diff(rows) > _GAP) + 1
    done = 0
    for run in np.split(rows, breaks):
        found[done : done + len(run)] = samples[run[0] : run[-1] + 1][run - run[0]]
        done += len(run)
    return found
