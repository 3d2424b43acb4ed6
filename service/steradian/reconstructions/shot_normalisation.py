"""Per-shot normalisation: energy, sensitivity, time zero and quality flags.

A-lines are put on one grid of times, divided by their pulse energy (and, where asked, by the share of the film's
sensitivity that a wavelength beside the best one left; the reconstruction weights them by it), and those whose quality
flags say that they mean something else are left out; the weights of the others make up for them. Bad A-lines are left
out or mended where that is asked.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.core.validation import Value
from steradian.reconstructions.bad_lines import BadLines, BadLinesFound, treat_bad_lines
from steradian.scans.file.tail import AlineBatch
from steradian.scans.recording import Recording, ShotMetadata
from steradian.scans.time_alignment import align, common_grid

Flag = Literal["saturated", "mistuned", "misfire", "partial"]
FLAG_BITS: dict[Flag, int] = {"saturated": 1, "mistuned": 2, "misfire": 4, "partial": 8}
"""Bits of an A-line's quality."""


class ShotTreatment(Value):
    """Options of shot normalisation: time zero, pulse energy, film sensitivity, excluded flags and bad A-lines."""

    time_zero: Literal["each", "common"] = Field(
        default="each", description="each: every A-line at the time at which it began; common: all at the earliest"
    )
    normalise_energy: bool = Field(default=True, description="Divide each A-line by its pulse energy")
    correct_sensitivity: bool = Field(
        default=False,
        description="Correct each A-line for the share of the film's sensitivity that its wavelength beside the best"
        " one left, by the plan's wavelengths and fringe; its weight falls with that share, as its noise does not",
    )
    leave_out: tuple[Flag, ...] = Field(
        default=("saturated", "mistuned"),
        description="A-lines with one of these flags are not used; the others' weights make up for them",
    )
    bad_lines: BadLines = Field(
        default="keep",
        description="A-lines that look bad beside their neighbours: keep (none is looked for); leave-out: dead, noisy,"
        " inverted, saturated and shifted ones; mend: the sign of inverted ones is turned, shifted ones are moved back,"
        " the others left out",
    )

    def select_shots(self, shots: ShotMetadata, known: bool | None = None) -> NDArray[np.bool_]:
        """Return the A-lines to use as a boolean mask (M,): not flagged, and with energy if energies are normalised.

        ``known``: whether the scan knows energies; None: these A-lines are all of it.
        """
        bits = np.uint32(sum(FLAG_BITS[flag] for flag in set(self.leave_out)))
        wanted: NDArray[np.bool_] = (shots.quality & bits) == 0
        if self._divides(shots, known):
            wanted &= shots.energy > 0
        return wanted

    def divisors(self, shots: ShotMetadata, known: bool | None = None) -> NDArray[np.float32]:
        """Return the divisor (M,) of each A-line: pulse energy times film sensitivity, as far as enabled."""
        found = shots.energy if self._divides(shots, known) else np.ones(len(shots.energy))
        if self.correct_sensitivity and shots.sensitivity is not None:
            found = found * shots.sensitivity
        return found.astype(np.float32)

    def _divides(self, shots: ShotMetadata, known: bool | None) -> bool:
        """Return whether A-lines are divided by pulse energy: if enabled and at least one energy is known."""
        return self.normalise_energy and bool(shots.energy.any() if known is None else known)


@dataclass
class ShotVariation:
    """Variation of energy, time zero and sensitivity between A-lines, for the reconstruction's report.

    Attributes
    ----------
    left_out
        A-lines not used, by flag; one with two flags counts twice. ``dark``: without pulse energy.
    energy
        Least and greatest pulse energy of the A-lines used, relative to nominal.
    time_zero_s
        Earliest and latest time zero of the A-lines used.
    sensitivity
        Least and greatest share of the film's sensitivity that A-lines were corrected for; ``None``: for none.
    bad_lines
        Bad A-lines and what was done about them; ``None``: none was looked for.
    """

    left_out: dict[str, int] = field(default_factory=dict)
    energy: tuple[float, float] | None = None
    time_zero_s: tuple[float, float] | None = None
    sensitivity: tuple[float, float] | None = None
    bad_lines: BadLinesFound | None = None


def normalise_shots(
    recording: Recording,
    treatment: ShotTreatment,
    *,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> tuple[Recording, ShotVariation]:
    """Normalise the A-lines of a recording; return the new recording and the variation between A-lines.

    A recording without :attr:`~steradian.scans.recording.Recording.shots` comes back as it is but for bad A-lines, and
    one that this returned comes back as it is. Of several frames the mean of each point's A-lines is returned, weighted
    by the inverse variance of their noise.

    Raises
    ------
    InvalidInput
        When no A-line is left, or their times have nothing in common.
    Cancelled
        When ``cancelled`` returned ``True`` while bad A-lines were looked for.
    """
    found = ShotVariation()
    if recording.shots is not None:
        wanted = treatment.select_shots(recording.shots)
        found.left_out = _left_out(recording.shots, treatment)
        if not wanted.any():
            raise InvalidInput(
                "shots.leave_out", ", ".join(treatment.leave_out), f"what leaves at least one of {len(wanted)} A-lines"
            )
        if not wanted.all():
            recording = recording.select(wanted)
    if treatment.bad_lines != "keep" and not recording.inspected:
        recording, found.bad_lines = treat_bad_lines(
            recording, treatment.bad_lines, progress=progress, cancelled=cancelled
        )
    shots = recording.shots
    if shots is None:
        return recording, found
    found.energy = float(shots.energy.min()), float(shots.energy.max())
    found.time_zero_s = float(shots.time_zero.min()), float(shots.time_zero.max())
    sensitivity = shots.sensitivity if treatment.correct_sensitivity else None
    if sensitivity is not None:
        found.sensitivity = float(sensitivity.min()), float(sensitivity.max())
    divisors = treatment.divisors(shots)
    scale = np.asarray(recording.scale, np.float32) / divisors
    traces = recording.traces
    if treatment.time_zero == "each" and np.ptp(shots.time_zero):
        delays, samples = common_grid(shots.time_zero, recording.sampling_interval, traces.shape[1])
        traces = align(traces.astype(np.float32), delays, samples)
    earliest = found.time_zero_s[0]
    even = replace(recording, traces=traces, scale=scale, time_zero=earliest, shots=None, sensitivity=sensitivity)
    return even.averaged(divisors.astype(np.float64) ** 2), found


def normalise_new_shots(new: AlineBatch, whole: Recording, treatment: ShotTreatment) -> AlineBatch:
    """Normalise new A-lines of a running scan, resampled to the time grid of the recording ``whole``."""
    wanted, shots = treatment.select_shots(new.shots, new.energy_known), new.shots
    traces = new.traces
    if not wanted.all():
        traces, shots = traces[wanted], shots.select(wanted)
    strengths = treatment.divisors(shots, new.energy_known)
    if (strengths != 1).any():
        traces = traces / strengths[:, None]
    delays = (shots.time_zero - whole.time_zero) / whole.sampling_interval
    if treatment.time_zero == "each" and delays.any():
        traces = align(traces, delays, whole.traces.shape[1])
    return replace(new, points=new.points[wanted], traces=traces, shots=shots)


def _left_out(shots: ShotMetadata, treatment: ShotTreatment) -> dict[str, int]:
    counts = {str(flag): int(((shots.quality & FLAG_BITS[flag]) != 0).sum()) for flag in treatment.leave_out}
    if treatment.normalise_energy and shots.energy.any():
        counts["dark"] = int((~(shots.energy > 0)).sum())
    return {name: count for name, count in counts.items() if count}
