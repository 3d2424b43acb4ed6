"""Frames of a series: selection among the frames of a scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from steradian.core.exceptions import InvalidInput
from steradian.scans.frames import SAME_LIGHT, Frame, FrameChoice, distinct_wavelengths, lights_of


@dataclass(frozen=True)
class SeriesFrame:
    """Frame of a series: the scan's frames that it is the mean of, their wavelength and time.

    Parameters
    ----------
    numbers
        Numbers of the scan's frames, from 0.
    excitation
        Excitation wavelength in m; 0: not stated.
    time
        Mean time of the first and last shot in s since the series' first shot; None: not known.
    name
        Name of a map that was computed of a series, such as saturation; "": it is an image of the scan's frames.
    """

    numbers: tuple[int, ...]
    excitation: float = 0.0
    time: float | None = None
    name: str = ""

    @property
    def choice(self) -> int | FrameChoice:
        """Selection of the scan's frames whose A-lines it is made of."""
        if len(self.numbers) == 1:
            return self.numbers[0]
        return FrameChoice(wavelength=self.excitation, average=True)

    def __str__(self) -> str:
        if self.name:
            return self.name
        light = f"{1e9 * self.excitation:g} nm, " if self.excitation else ""
        count = len(self.numbers)
        return f"{light}frame {self.numbers[0]}" if count == 1 else f"{light}mean of {count} frames"


def measured(frames: Sequence[Frame]) -> list[Frame]:
    """Return the frames that have A-lines; all, if none has: then reading one says why."""
    return [each for each in frames if each.stored] or list(frames)


def series_choices(
    frames: Sequence[Frame], *, wavelength: float | None = None, average: bool = False
) -> list[tuple[SeriesFrame, int | FrameChoice]]:
    """Return the frames of a series, each with the frame selection that reads its recording.

    Parameters
    ----------
    frames
        Of the scan.
    wavelength
        Excitation wavelength in m to which the series is limited; None: all.
    average
        The mean of the frames at each wavelength, instead of each frame.

    Raises
    ------
    InvalidInput
        When no frame has that wavelength.
    """
    chosen = [each for each in frames if wavelength is None or abs(each.excitation - wavelength) < SAME_LIGHT]
    if not chosen:
        value = f"{1e9 * (wavelength or 0):g} nm"
        raise InvalidInput("wavelength", value, f"one that the scan was measured at: {lights_of(frames)}")
    shots = [shot for each in chosen for shot in (each.first_shot, each.last_shot) if shot is not None]
    start = min(shots) if shots and max(shots) > min(shots) else None  # imported scans have no times: all are 0
    if not average:
        return [(_described([each], start), each.index) for each in chosen]
    groups = [[e for e in chosen if abs(e.excitation - light) < SAME_LIGHT] for light in distinct_wavelengths(chosen)]
    described = [_described(group, start) for group in groups]
    return [(frame, frame.choice) for frame in described]


def _described(frames: Sequence[Frame], start: float | None) -> SeriesFrame:
    shots = [shot for each in frames for shot in (each.first_shot, each.last_shot) if shot is not None]
    time = None if start is None or not shots else sum(shots) / len(shots) - start
    return SeriesFrame(tuple(each.index for each in frames), frames[0].excitation, time)
