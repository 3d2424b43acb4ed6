"""Exclusion or correction of bad A-lines (dead, noisy, inverted, shifted) before a reconstruction."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.quality.bad_lines import BadLine
from steradian.quality.repair import measure_shifts, turn_sign
from steradian.quality.signals import inspect_signals
from steradian.scans.recording import Recording, ShotMetadata
from steradian.scans.time_alignment import align

BadLines = Literal["keep", "leave-out", "mend"]
MOST_LISTED: Final = 500
"""Rows of each kind in a report; the counts tell all."""


@dataclass
class BadLinesFound:
    """Bad A-lines of a recording, and their treatment: excluded or corrected.

    Attributes
    ----------
    treatment
        ``leave-out`` or ``mend``.
    looked_at
        A-lines that were compared with their neighbours.
    decidable
        Whether neighbours are similar enough to detect inverted and shifted A-lines.
    left_out, mended
        Number of A-lines by kind.
    rows
        By kind the A-lines' numbers in the scan's array of A-lines, frame after frame; 500 of a kind at most.
    shifts_s
        Least and greatest shift in s by which shifted A-lines were late, where they were moved back.
    """

    treatment: BadLines
    looked_at: int = 0
    decidable: bool = True
    left_out: dict[str, int] = field(default_factory=dict)
    mended: dict[str, int] = field(default_factory=dict)
    rows: dict[str, list[int]] = field(default_factory=dict)
    shifts_s: tuple[float, float] | None = None

    def note(self) -> str:
        """Return a note for the report on the excluded and corrected A-lines."""
        said = []
        if self.left_out:
            said.append(f"left out {_of(self.left_out, self.looked_at)}: {_listed(self.left_out)}")
        if self.mended:
            said.append(f"mended {_of(self.mended, self.looked_at)}: {_listed(self.mended)}")
        if self.shifts_s is not None:
            said.append("moved back by {:+.0f} to {:+.0f} ns".format(*(1e9 * shift for shift in self.shifts_s)))
        if not said:
            said.append(f"no bad A-line among {self.looked_at:,}")
        if not self.decidable:
            said.append("inverted and shifted ones cannot be detected, because neighbours are not similar")
        return "; ".join(said)


def treat_bad_lines(
    recording: Recording,
    treatment: BadLines,
    *,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> tuple[Recording, BadLinesFound]:
    """Find bad A-lines of a recording, frame by frame, and exclude or correct them.

    Parameters
    ----------
    recording
        As measured; frames that are to be averaged are compared each in itself.
    treatment
        ``leave-out``: all bad A-lines; ``mend``: the sign of inverted ones is turned, shifted ones are moved back in
        their record, whose free end is filled with their median, and the others are left out.
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Returns
    -------
    tuple
        The recording with what was done among its notes, its weights in proportion to those before, and the lists.

    Raises
    ------
    InvalidInput
        When no A-line is left.
    Cancelled
        When ``cancelled`` returned ``True``.
    """
    rows = np.arange(len(recording.traces)) if recording.rows is None else recording.rows
    found = BadLinesFound(treatment, looked_at=len(rows))
    bad: list[BadLine] = []
    for those in _frames(recording, rows):
        lines, decidable = _inspect(recording, those, treatment == "mend", progress, cancelled)
        bad += lines
        found.decidable &= decidable
    unmended = [line for line in bad if treatment == "leave-out" or line.mend == "leave-out"]
    if len(unmended) == len(rows):
        raise InvalidInput("shots.bad_lines", treatment, f"keep: all {len(rows)} A-lines look bad")
    if treatment == "mend":
        recording = _mended(recording, bad)
        shifts = [line.shift for line in bad if line.kind == "shifted"]
        found.shifts_s = (min(shifts), max(shifts)) if shifts else None
    found.left_out = _counted(unmended)
    found.mended = _counted([line for line in bad if treatment == "mend" and line.mend != "leave-out"])
    for line in bad:
        listed = found.rows.setdefault(line.kind, [])
        if len(listed) < MOST_LISTED:
            listed.append(int(rows[line.aline]))
    if unmended:
        wanted = np.ones(len(rows), bool)
        wanted[[line.aline for line in unmended]] = False
        recording = recording.select(wanted)
    return replace(recording, notes=(*recording.notes, found.note()), inspected=True), found


def _inspect(
    recording: Recording,
    those: NDArray[np.int64],
    measure: bool,
    progress: Progress | None,
    cancelled: CancelCheck | None,
) -> tuple[list[BadLine], bool]:
    """Find the bad A-lines among a subset of a recording; ``measure`` adds precise time shifts of shifted ones."""
    positions, interval = recording.positions[those], recording.sampling_interval
    traces = recording.traces if len(those) == len(recording.traces) else recording.traces[those]
    zeros = _zeros(recording)[those]
    seen = inspect_signals(
        traces,
        interval,
        positions,
        time_zero=zeros,
        scale=np.broadcast_to(np.asarray(recording.scale, np.float32), len(recording.traces))[those],
        sound_speed=recording.sound_speed or 1500.0,
        progress=progress,
        cancelled=cancelled,
    )
    bad = list(seen.bad)
    if measure:
        shifts = iter(
            measure_shifts(
                traces, interval, positions, bad, time_zero=zeros, progress=progress, cancelled=cancelled
            ).tolist()
        )
        bad = [replace(line, shift=next(shifts)) if line.kind == "shifted" else line for line in bad]
    return [replace(line, aline=int(those[line.aline])) for line in bad], seen.decidable


def _counted(lines: Sequence[BadLine]) -> dict[str, int]:
    """Return the number of bad A-lines of each kind."""
    return dict(Counter(str(line.kind) for line in lines))


def _mended(recording: Recording, bad: Sequence[BadLine]) -> Recording:
    """Return the recording with inverted A-lines multiplied by -1 and shifted A-lines moved back in time."""
    inverted = [line.aline for line in bad if line.kind == "inverted"]
    shifts = {line.aline: line.shift for line in bad if line.kind == "shifted"}
    if not inverted and not shifts:
        return recording
    traces = recording.traces.astype(np.float32)
    if inverted:
        turn_sign(traces, inverted)
    if shifts:
        rows = np.array(list(shifts))
        level = np.median(traces[rows], axis=1, keepdims=True)
        delays = -np.array(list(shifts.values())) / recording.sampling_interval
        traces[rows] = align(traces[rows] - level, delays, traces.shape[1]) + level
    return replace(recording, traces=traces)


def _frames(recording: Recording, rows: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return one array for each frame with the indices of its A-lines."""
    if recording.points is None:
        return [np.arange(len(rows))]
    frames = rows // recording.planned
    return [np.flatnonzero(frames == frame) for frame in np.unique(frames)]


def _zeros(recording: Recording) -> NDArray[np.float64]:
    shots: ShotMetadata | None = recording.shots
    zeros: Any = recording.time_zero if shots is None else shots.time_zero
    return np.asarray(np.broadcast_to(zeros, len(recording.traces)), np.float64)


def _of(counts: dict[str, int], of: int) -> str:
    return f"{sum(counts.values()):,} of {of:,} A-lines"


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{count:,} {kind}" for kind, count in counts.items())
