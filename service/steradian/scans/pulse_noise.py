"""Noise of one laser pulse in a stored scan."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from steradian.quality.pulse_noise import PulseNoise, measure_pulse_noise
from steradian.scans.frames import FrameChoice
from steradian.scans.opening import FIRST, open_recording
from steradian.scans.recording import Recording


class ScanNoise(NamedTuple):
    """Noise of one pulse, and sampling interval (s) and sound speed (m/s, ``None``: not stated) of the scan."""

    noise: PulseNoise
    sampling_interval: float
    sound_speed: float | None


def pulse_noise_of(recording: Recording) -> PulseNoise:
    """Return the noise of one pulse of a recording; without shot metadata its A-lines count as single pulses.

    Raises
    ------
    InvalidInput
        When the A-lines are too short, or none of them stands out of the noise.
    """
    averages = 1 if recording.shots is None else recording.shots.averages.clip(1)
    return measure_pulse_noise(recording.traces, averages, recording.scale)


def read_pulse_noise(path: Path, frame: int | FrameChoice = FIRST) -> ScanNoise:
    """Measure the noise of one pulse in a scan file or another supported recording.

    Raises
    ------
    NotFound, DamagedFile, InvalidInput
        See :func:`steradian.scans.opening.open_recording` and :func:`pulse_noise_of`.
    """
    recording = open_recording(path, frame)
    return ScanNoise(pulse_noise_of(recording), recording.sampling_interval, recording.sound_speed)
