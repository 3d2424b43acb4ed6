"""Reader of series files for export: one slab of one volume is in memory at a time."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from steradian._version import __version__
from steradian.core.exceptions import DamagedFile
from steradian.core.progress import CancelCheck, Progress
from steradian.reconstructions.exporting.source import VolumeExportSource
from steradian.reconstructions.series.file import read_frames
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.volumes.file import centre_in
from steradian.scans.file.h5py_errors import reraise_as_damaged
from steradian.scans.frames import SAME_LIGHT, light_name

EVEN = 0.05
"""Share by which intervals of time may differ that are written as one interval."""


@dataclass(frozen=True)
class SeriesExportSource:
    """Reader of a series file for export.

    Parameters
    ----------
    volumes
        Readers of its volumes, in the order of measurement.
    frames
        Frames of the volumes.
    """

    volumes: tuple[VolumeExportSource, ...]
    frames: tuple[SeriesFrame, ...]

    @property
    def first(self) -> VolumeExportSource:
        """Reader of the first volume, which has the voxels of all."""
        return self.volumes[0]

    @cached_property
    def channels(self) -> list[list[int]]:
        """Numbers of the volumes of each excitation wavelength, in the order of measurement; of each map of another."""
        groups: list[list[int]] = []
        for number, frame in enumerate(self.frames):
            for group in groups:
                if not frame.name and abs(self.frames[group[0]].excitation - frame.excitation) < SAME_LIGHT:
                    group.append(number)
                    break
            else:
                groups.append([number])
        return groups

    @property
    def is_regular(self) -> bool:
        """Whether each wavelength has the same number of volumes, so that they fill a grid of time and channel."""
        return len({len(group) for group in self.channels}) == 1

    @property
    def grid(self) -> list[list[int]]:
        """Numbers of the volumes by time and channel; a ragged series has one time, and a channel for each volume."""
        if not self.is_regular:
            return [list(range(len(self.frames)))]
        return [list(each) for each in zip(*self.channels, strict=True)]

    @property
    def channel_names(self) -> list[str]:
        """Name of each channel of the grid: the wavelength, and of a ragged series the frame, too."""
        if self.is_regular:
            first = [self.frames[group[0]] for group in self.channels]
            return [frame.name or light_name(frame.excitation) for frame in first]
        return [str(frame) for frame in self.frames]

    @property
    def interval(self) -> float | None:
        """Time between rows of the grid in s; None where it is not known or not even."""
        times = [self.frames[row[0]].time for row in self.grid]
        known = np.array([time for time in times if time is not None])
        if len(known) < max(2, len(times)):
            return None
        steps = np.diff(known)
        mean = float(steps.mean())
        return mean if mean > 0 and np.abs(steps - mean).max() <= EVEN * mean else None

    def description(self) -> dict[str, Any]:
        """Return frames, wavelengths and times for metadata; names as in BIDS where it has them."""
        return {
            "Units": "arbitrary",
            "FrameTimesStart": [frame.time for frame in self.frames],
            "ExcitationWavelength": [1e9 * frame.excitation or None for frame in self.frames],
            "ExcitationWavelengthUnits": "nm",
            "ScanFrames": [list(frame.numbers) for frame in self.frames],
            **({"Maps": [frame.name for frame in self.frames]} if self.frames[0].name else {}),
            "SoftwareName": "steradian",
            "SoftwareVersions": __version__,
            "SteradianParameters": json.loads(self.first.parameters),
            "SteradianProvenance": json.loads(self.first.provenance),
        }


@contextmanager
def open_series(path: Path, progress: Progress | None, cancelled: CancelCheck | None) -> Iterator[SeriesExportSource]:
    """Open a series file as a :class:`SeriesExportSource`.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is truncated, of another kind, or has no volume.
    """
    frames = read_frames(path)
    if not frames:
        raise DamagedFile(f"{path}: a series without a volume")
    with ExitStack() as opened:
        with reraise_as_damaged(path, "series"):
            file = opened.enter_context(h5py.File(path, "r"))
            texts = [str(file.attrs[name]) for name in ("parameters", "provenance")]
            volumes = []
            for number in range(len(frames)):
                values = file[f"frames/{number}/values"]
                spacing, origin = (tuple(map(float, values.attrs[name])) for name in ("spacing_m", "origin_m"))
                names = tuple(str(values.attrs["axes"]).split(", "))
                origin = tuple(first + moved for first, moved in zip(origin, centre_in(file, len(origin)), strict=True))
                if values.shape != file["frames/0/values"].shape or len(names) != len(values.shape):
                    raise DamagedFile(f"{path}: volume {number} has the shape {values.shape} and axes {names}")
                step = _step_of(progress, number, len(frames))
                parameters, provenance = texts
                volumes.append(
                    VolumeExportSource(values, names, spacing, origin, parameters, provenance, step, cancelled)
                )
        yield SeriesExportSource(tuple(volumes), tuple(frames))


def _step_of(progress: Progress | None, number: int, count: int) -> Progress | None:
    if progress is None:
        return None
    return lambda stage, done, total: progress(f"volume {number + 1} of {count}, {stage}", done, total)
