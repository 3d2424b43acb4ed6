"""Frames of a scan (repetitions or wavelengths), and the selection of frames for an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from steradian.core.exceptions import InvalidInput

SAME_LIGHT = 0.5e-9
"""Wavelengths closer than this, in m, are one."""


@dataclass(frozen=True)
class Frame:
    """Frame of a scan: one A-line at every point of the mask, at one excitation wavelength.

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


@dataclass(frozen=True)
class FrameChoice:
    """Selection of the frames for an image: one frame or a mean; the first frame by default.

    Parameters
    ----------
    frame
        Number of one frame, from 0.
    wavelength
        Excitation wavelength in m; without ``average`` the first frame measured at it.
    average
        The mean of all frames, or of those at ``wavelength``; they must have one excitation wavelength.

    Raises
    ------
    InvalidInput
        When ``frame`` is given together with another.
    """

    frame: int | None = None
    wavelength: float | None = None
    average: bool = False

    def __post_init__(self) -> None:
        if self.frame is not None and (self.average or self.wavelength is not None):
            raise InvalidInput("frame", self.frame, "neither wavelength nor average with it")

    def pick(self, frames: Sequence[Frame]) -> tuple[list[int], tuple[str, ...]]:
        """Return the numbers of the selected frames, and a note if the first frame was selected by default.

        Raises
        ------
        InvalidInput
            When there is no such frame or wavelength, or when the frames to be averaged differ in wavelength.
        """
        if self.frame is not None:
            return [frame_number(self.frame, len(frames))], ()
        among = [each for each in frames if self.wavelength is None or self._fits(each)]
        if not among:
            value = f"{1e9 * (self.wavelength or 0):g} nm"
            raise InvalidInput("wavelength", value, f"one that the scan was measured at: {lights_of(frames)}")
        if self.average:
            if len(distinct_wavelengths(among)) > 1:
                raise InvalidInput("average", "true", f"with one wavelength of several: {lights_of(frames)}")
            return [each.index for each in among], ()
        return [among[0].index], _notes(among, len(frames))

    def _fits(self, frame: Frame) -> bool:
        return self.wavelength is not None and abs(frame.excitation - self.wavelength) < SAME_LIGHT


def frame_number(frame: int | None, frames: int) -> int:
    """Return the given frame number after validation; for ``None``, 0 if the scan has a single frame.

    Raises
    ------
    InvalidInput
        When there is no such frame, or none is named of several.
    """
    if frame is None and frames == 1:
        return 0
    if isinstance(frame, bool) or not isinstance(frame, int | np.integer) or not 0 <= frame < frames:
        allowed = f"a whole number, 0 to {frames - 1}" if frames > 1 else "0, or None: the scan has one frame"
        raise InvalidInput("frame", frame, allowed)
    return int(frame)


def distinct_wavelengths(frames: Sequence[Frame]) -> list[float]:
    """Return the distinct excitation wavelengths of frames in m, in the order of measurement; 0: not stated.

    Values closer than ``SAME_LIGHT`` are one: a file may have rounded them, or hold what the laser answered.
    """
    found: list[float] = []
    for frame in frames:
        if not any(abs(frame.excitation - each) < SAME_LIGHT for each in found):
            found.append(frame.excitation)
    return found


def lights_of(frames: Sequence[Frame]) -> str:
    """Return the distinct excitation wavelengths of frames as text."""
    return ", ".join(map(light_name, distinct_wavelengths(frames)))


def light_name(excitation: float) -> str:
    """Return an excitation wavelength in m as text in nm; 0: not stated."""
    return f"{1e9 * excitation:g} nm" if excitation else "not stated"


def _notes(among: Sequence[Frame], count: int) -> tuple[str, ...]:
    """Return a note on the frame selected by default and the options for selecting others; empty for one frame."""
    if len(among) == 1:
        return ()
    light = f", {lights_of(among[:1])}" if among[0].excitation else ""
    return (
        f"made of frame {among[0].index} of {count} (0 to {count - 1}{light}); "
        "frame, wavelength or average choose others or their mean",
    )
