"""Series of volumes on the same voxels: one for each frame of a scan, or for each mean of frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from steradian.core.exceptions import InvalidInput
from steradian.drawing import display_dispatch
from steradian.imaging import Volume
from steradian.reconstructions.series.file import is_series_file, read_frames
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.volumes.file import read_volume
from steradian.scans.frames import SAME_LIGHT

if TYPE_CHECKING:
    from steradian.quality.region_statistics import RegionOfInterest
    from steradian.quality.registration import Shift
    from steradian.spectroscopy import Unmixed


class Series(Sequence[Volume]):
    """Sequence of volumes on the same voxels, in the order of measurement; those of a file are read when asked for.

    Parameters
    ----------
    frames
        What each volume is made of.
    load
        Function from a number, 0 to len(frames) − 1, to the volume.
    """

    def __init__(self, frames: Sequence[SeriesFrame], load: Callable[[int], Volume]) -> None:
        self.frames = tuple(frames)
        self._load = load

    def __len__(self) -> int:
        return len(self.frames)

    @overload
    def __getitem__(self, index: int) -> Volume: ...
    @overload
    def __getitem__(self, index: slice) -> Series: ...
    def __getitem__(self, index: int | slice) -> Volume | Series:
        """Return a volume, or a part of the series; raises IndexError for a number beyond the last."""
        if isinstance(index, slice):
            return self.part(range(len(self))[index])
        if not -len(self) <= index < len(self):
            raise IndexError(f"volume {index} of a series of {len(self)}")
        return self._load(index % len(self))

    def __repr__(self) -> str:
        light = ", ".join(f"{1e9 * each:g} nm" for each in self.wavelengths)
        return f"<Series: {len(self)} volumes{', ' + light if light else ''}>"

    @property
    def wavelengths(self) -> tuple[float, ...]:
        """Distinct excitation wavelengths in m, in the order of measurement; () where they are not stated."""
        found: list[float] = []
        for frame in self.frames:
            if frame.excitation and not any(abs(frame.excitation - each) < SAME_LIGHT for each in found):
                found.append(frame.excitation)
        return tuple(found)

    def at(self, wavelength: float) -> Series:
        """Return the volumes of one excitation wavelength in m.

        Raises
        ------
        InvalidInput
            If there is none.
        """
        numbers = [n for n, each in enumerate(self.frames) if abs(each.excitation - wavelength) < SAME_LIGHT]
        if not numbers:
            allowed = ", ".join(f"{1e9 * each:g} nm" for each in self.wavelengths) or "none: wavelengths are not stated"
            raise InvalidInput("wavelength", f"{1e9 * wavelength:g} nm", allowed)
        return self.part(numbers)

    def part(self, numbers: Sequence[int]) -> Series:
        """Return the series of some volumes, by their numbers from 0."""
        return Series([self.frames[n] for n in numbers], lambda n: self._load(numbers[n]))

    def mean(self) -> Volume:
        """Return the mean of the volumes, which must have one excitation wavelength.

        Raises
        ------
        InvalidInput
            If they have several.
        """
        if len(self.wavelengths) > 1:
            raise InvalidInput("wavelength", f"{len(self.wavelengths)} of them", "one: series.at(wavelength).mean()")
        first = self[0]
        total = np.array(first.values, np.float64)
        for number in range(1, len(self)):
            total += self[number].values
        values = (total / len(self)).astype(first.values.dtype)
        return Volume(values, first.axes, first.spacing, first.sound_speed)

    def aligned(self, reference: int = 0) -> tuple[Series, list[Shift]]:
        """Return the series with the object of each volume moved to its place in one of them, and the shifts.

        Shifts within twice their standard error are not undone.

        Parameters
        ----------
        reference
            Number of the volume at whose place the object stays.
        """
        from steradian.quality.registration import estimate_shift

        still = self[reference]
        shifts = [estimate_shift(still, volume) for volume in self]

        def load(number: int) -> Volume:
            volume = self[number]
            return shifts[number].undo(volume) if shifts[number].is_significant else volume

        return Series(self.frames, load), shifts

    def measure(
        self, regions: Sequence[RegionOfInterest], background: RegionOfInterest | None = None
    ) -> list[dict[str, Any]]:
        """Return a row of statistics for each volume and region, with the volume's frames, wavelength and time.

        Rows of the maps of an unmixing also have the name of the ``map``.

        Raises
        ------
        InvalidInput
            As of :func:`steradian.quality.region_statistics`.
        """
        from steradian.quality.region_statistics import region_statistics

        return [
            {"frames": frame.numbers, "excitation": frame.excitation, "time": frame.time}
            | ({"map": frame.name} if frame.name else {})
            | found.row()
            for frame, volume in zip(self.frames, self, strict=True)
            for found in region_statistics(volume, regions, background)
        ]

    def unmix(self, chromophores: Sequence[Any] = ("oxyhaemoglobin", "deoxyhaemoglobin"), **options: Any) -> Unmixed:
        """Unmix the means at each wavelength (:func:`steradian.spectroscopy.unmix`, which has the options).

        Raises
        ------
        InvalidInput
            If no wavelengths are stated, or as of that function.
        """
        from steradian.spectroscopy import unmix

        if not self.wavelengths:
            raise InvalidInput("wavelengths", "not stated", "a series of a scan with excitation wavelengths")
        means = [self.at(each).mean() for each in self.wavelengths]
        return unmix(means, self.wavelengths, chromophores, **options)

    def figure(self, path: str | Path, **options: Any) -> Path:
        """Write a figure for a paper to a ``.pdf``, ``.svg`` or ``.png`` file: projections with one colour scale.

        Parameters
        ----------
        path
            File to write.
        **options
            As of :meth:`steradian.Volume.figure`, without ``name``; ``columns``, the most panels side by side (4).

        Raises
        ------
        InvalidInput
            When the ending is another one, a value is out of range, or the series has more than 36 volumes.
        """
        return display_dispatch.figure(self, Path(path), **options)

    def film(self, path: str | Path, **options: Any) -> Path:
        """Write the projections of all volumes one after another as an animated GIF that repeats.

        Parameters
        ----------
        path
            File to write, ``.gif``.
        **options
            ``interval`` in s that each volume is shown (0.2), ``size`` of the longest side in pixels (480), ``axis``
            ("z"), ``colour_map`` ("inferno"), ``percentile`` (99.9) or ``limits`` of the scale, ``near_field``
            in m (0).

        Raises
        ------
        InvalidInput
            When the ending is another one, or a value is out of range.
        """
        return display_dispatch.figure(self, Path(path), film=True, **options)

    def save(self, path: str | Path) -> None:
        """Write the series into a file by an atomic write; the suffix determines the format.

        ``.h5``, which :func:`steradian.open` reads; ``.nii``, ``.nii.gz``, ``.tif`` and ``.zarr`` for other programs.

        Raises
        ------
        InvalidInput
            When the ending is another one, or the format cannot hold the series.
        Conflict
            When there is a folder of that name.
        """
        display_dispatch.save(self, Path(path))


def open_as_series(path: Path) -> Series:
    """Open a series file, or a volume file as a series of one; raises as :func:`read_series`."""
    if is_series_file(path):
        return read_series(path)
    return Series([SeriesFrame((0,))], lambda _: read_volume(path))


def read_series(path: Path) -> Series:
    """Read a series file; its volumes are read when asked for.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is truncated or of another kind.
    """
    return Series(read_frames(path), lambda number: read_volume(path, number))
