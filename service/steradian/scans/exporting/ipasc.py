"""Export of scans as IPASC HDF5, the format of the International Photoacoustic Standardisation Consortium.

``binary_time_series_data`` [detector, sample, wavelength, frame] in the pressure unit as float32; every tag a dataset
in SI units; a group for each detector. The standard has no tag for the time of the first sample nor for what a point
stands for, so these go under names of our own (:mod:`steradian.scans.importing.ipasc`). A-lines that begin at different
times after their pulses are put on one grid of times (:mod:`steradian.scans.time_alignment`). Wavelengths of the light
that nobody knows are 0, for PATATO opens no file without any.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import Cancelled, DamagedFile
from steradian.core.progress import CancelCheck, Progress
from steradian.scans.file.aline_metadata import ShotTable
from steradian.scans.file.arrangement_metadata import arrangement_of, centre_of
from steradian.scans.importing import ipasc
from steradian.scans.time_alignment import align, common_grid

BLOCK_BYTES = 16 << 20
NAMESPACE = uuid.UUID("6d0a2f0e-6b8c-5a55-9a8e-0d1c2f3b4a59")
"""Makes the same scan's export carry the same identifier every time."""
EVERY = 2000
"""Detectors between two looks at ``cancelled``."""


def write_ipasc(scan: h5py.File, draft: Path, progress: Progress | None, cancelled: CancelCheck | None) -> None:
    """Write an open scan file as IPASC HDF5.

    Raises
    ------
    DamagedFile
        When it holds no point with all its frames.
    Cancelled
        When ``cancelled`` said so.
    """
    with h5py.File(draft, "w") as made:
        _Exporter(scan, made, progress, cancelled).write()


class _Exporter:
    """Writer of an open scan file into an open IPASC file."""

    def __init__(
        self, scan: h5py.File, made: h5py.File, progress: Progress | None, cancelled: CancelCheck | None
    ) -> None:
        self._scan, self._made, self._progress, self._cancelled = scan, made, progress, cancelled
        self._samples, self._table = scan["alines/samples"], ShotTable.of_file(scan)
        self._points = len(scan["mask/weights"])
        self._frames = self._samples.shape[0] // self._points
        light = scan["plan/frame_excitation"][()] if "plan/frame_excitation" in scan else np.zeros(self._frames)
        self._light = np.array(list(dict.fromkeys(light.tolist())))

    def write(self) -> None:
        kept = np.flatnonzero(self._intact().all(axis=0))
        if not len(kept):
            raise DamagedFile(f"{self._scan.filename} holds no point with an A-line in every frame")
        starts = self._table["time_zero_s"].reshape(self._frames, self._points)[:, kept]
        delays, samples = common_grid(
            starts, float(self._scan["plan"].attrs["sampling_interval_s"]), self._samples.shape[1]
        )
        shape = (len(kept), samples, len(self._light), self._frames // len(self._light))
        self._series(kept, shape, delays)
        self._acquisition(kept, shape, float(starts.min()))
        self._device(kept)

    def _blocks(self, frame: int, stage: str) -> Iterator[tuple[int, NDArray[Any]]]:
        """Yield the samples of a frame in blocks of points, each with the number of its first point."""
        step = max(1, BLOCK_BYTES // (self._samples.shape[1] * 4))
        total = self._frames * self._points
        for start in range(0, self._points, step):
            stop = min(start + step, self._points)
            self._note(stage, frame * self._points + start, total)
            yield start, self._samples[frame * self._points + start : frame * self._points + stop]
        self._note(stage, (frame + 1) * self._points, total)

    def _intact(self) -> NDArray[np.bool_]:
        """Return a boolean array (F, M): rows with an A-line that matches its checksum."""
        good = self._table.stored
        for frame in range(self._frames):
            for start, block in self._blocks(frame, "checked A-lines"):
                rows = slice(frame * self._points + start, frame * self._points + start + len(block))
                good[rows] &= self._table.take(rows).verify_rows(block)
        return good.reshape(self._frames, self._points)

    def _series(self, kept: NDArray[np.int64], shape: tuple[int, ...], delays: NDArray[np.float64]) -> None:
        series = self._made.create_dataset(ipasc.SERIES, shape, np.float32)
        scale = self._table["scale"].reshape(self._frames, self._points)
        for frame in range(self._frames):
            light, repeat = divmod(frame, shape[3])
            for start, block in self._blocks(frame, "A-lines"):
                wanted = kept[(kept >= start) & (kept < start + len(block))]
                if len(wanted):
                    place = int(np.searchsorted(kept, wanted[0]))
                    part = slice(place, place + len(wanted))
                    pressure = (block[wanted - start] * scale[frame, wanted, None]).astype(np.float32)
                    if delays.any():
                        pressure = align(pressure, delays[frame, part], shape[1])
                    series[part, :, light, repeat] = pressure

    def _acquisition(self, kept: NDArray[np.int64], shape: tuple[int, ...], time_zero: float) -> None:
        plan, mask, origin = self._scan["plan"].attrs, self._scan["mask"], self._scan.attrs
        weights = mask["weights"][()][kept]
        identity = f"{origin['scan_id']}/{plan['id']}/{origin['created']}"
        tags: dict[str, Any] = {
            "uuid": str(uuid.uuid5(NAMESPACE, identity)),
            "encoding": "raw",
            "compression": "raw",
            "data_type": "float32",
            "dimensionality": "time",
            "sizes": np.array(shape),
            "ad_sampling_rate": 1 / float(plan["sampling_interval_s"]),
            "speed_of_sound": float(plan["sound_speed_m_s"]),
            "photoacoustic_imaging_device_reference": self._device_name(),
            "scanning_method": "one detection point of the list after the other",
            "acquisition_wavelengths": self._light,
            "measurements_per_image": shape[0],
            "overall_gain": 1.0,
            "time_gain_compensation": np.ones(shape[1]),
            "element_dependent_gain": np.ones(shape[0]),
            ipasc.TIME_ZERO: time_zero,
            ipasc.APERTURE: float(mask.attrs["aperture_m"]),
            ipasc.WEIGHTS: weights * (mask["weights"][()].sum() / weights.sum()),
            ipasc.SIMULATED: int(origin["simulated"]),
        }
        if "depth_m" in mask.attrs:
            tags[ipasc.DEPTH] = float(mask.attrs["depth_m"])
        for tag, name in ((ipasc.ENERGY, "energy"), (ipasc.QUALITY, "quality")):
            tags[tag] = self._table[name].reshape(*shape[2:], self._points)[..., kept].transpose(2, 0, 1)
        times = self._scan["alines/fire_time_s"][()].reshape(self._frames, self._points)[:, kept]
        if times.any():  # an imported scan may not know them
            tags["measurement_timestamps"] = times.min(axis=1)
        group = self._made.create_group(ipasc.ACQUISITION)
        for name, value in tags.items():
            group[name] = _text(value) if isinstance(value, str) else value

    def _device(self, kept: NDArray[np.int64]) -> None:
        plan, mask = self._scan["plan"].attrs, self._scan["mask"]
        half = float(mask.attrs["aperture_m"]) / 2
        reach = (self._samples.shape[1] - 1) * float(plan["sampling_interval_s"]) * float(plan["sound_speed_m_s"])
        device = self._made.create_group(ipasc.DEVICE)
        general = device.create_group("general")
        general["unique_identifier"] = _text(self._device_name())
        x, y, *_ = (*centre_of(arrangement_of(mask), mask["positions"].shape[1]), 0.0, 0.0)
        general["field_of_view"] = np.array([x - half, x + half, y - half, y + half, 0.0, reach])
        general["num_detectors"], general["num_illuminators"] = len(kept), 0
        device.create_group("illuminators")
        positions = np.zeros((len(kept), 3))
        centre = centre_of(arrangement_of(mask), mask["positions"].shape[1]) or 0.0
        lateral = mask["positions"][()][kept] + centre
        positions[:, : lateral.shape[1]] = lateral
        _write_detectors(device.create_group("detectors"), positions, self._note)

    def _device_name(self) -> str:
        return str(self._scan.attrs["scanner"]) or "unknown scanner"

    def _note(self, stage: str, done: int, total: int) -> None:
        if self._cancelled and self._cancelled():
            raise Cancelled(f"the export was stopped at {done} of {total} {stage}")
        if self._progress:
            self._progress(stage, done, total)


def _text(value: str) -> np.bytes_:
    """Return a text as a fixed-length string, because Octave rejects files with variable-length strings."""
    return np.bytes_(value.encode())


def _write_detectors(group: h5py.Group, positions: NDArray[np.float64], note: Progress) -> None:
    """Write an HDF5 group for each detector, with the low-level h5py API for speed."""
    low, space, kind = h5py.h5d, h5py.h5s.create_simple((3,)), h5py.h5t.IEEE_F64LE
    ahead = np.array([0.0, 0.0, 1.0])
    for index, position in enumerate(np.ascontiguousarray(positions)):
        if index % EVERY == 0:
            note("detectors", index, len(positions))
        detector = h5py.h5g.create(group.id, f"{index:010d}".encode())
        for name, value in ((b"detector_position", position), (b"detector_orientation", ahead)):
            low.create(detector, name, kind, space).write(h5py.h5s.ALL, h5py.h5s.ALL, value)
    note("detectors", len(positions), len(positions))
