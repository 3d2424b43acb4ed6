"""Inspection of a scan's A-lines before reconstruction: noise, baseline and bad A-lines."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from steradian.core.json_encoding import to_jsonable
from steradian.core.progress import CancelCheck, Progress
from steradian.quality.signals import SignalReport, inspect_signals
from steradian.scans.opening import open_recording
from steradian.scans.recording import Recording

MOST_MAPPED: Final = 20_000
"""A-lines in the maps of the plain report; of more, every second, third … is told."""
MOST_BAD: Final = 5_000
"""Bad A-lines listed in the plain report; the counts by kind tell all."""


@dataclass(frozen=True, eq=False)
class Inspection:
    """Result of the inspection of one frame of a scan.

    Attributes
    ----------
    signals
        The report; its A-lines are those of ``recording``.
    recording
        What was inspected.
    rows
        (n,) number of each A-line in the scan's array of A-lines, frame after frame.
    frame
        Number of the frame.
    """

    signals: SignalReport
    recording: Recording
    rows: NDArray[np.int64]
    frame: int

    @property
    def kinds(self) -> dict[str, int]:
        """Number of bad A-lines by kind."""
        return dict(Counter(line.kind for line in self.signals.bad))

    def to_dict(self) -> dict[str, Any]:
        """Return the report as a JSON-compatible dictionary in SI units, with null for unknown values."""
        told, places = self.signals, self.recording.positions
        some = slice(None, None, -(-len(places) // MOST_MAPPED))
        y = places[:, 1] if places.shape[1] > 1 else np.zeros(len(places))
        maps = {
            "x": places[some, 0],
            "y": y[some],
            "power": told.power[some],
            "baseline_mean": told.baseline_mean[some],
            "baseline_variance": told.baseline_variance[some],
            "arrival": told.arrival[some],
        }
        bad = [
            {
                "aline": int(self.rows[line.aline]),
                "x": float(places[line.aline, 0]),
                "y": float(y[line.aline]),
                "kind": line.kind,
                "detail": line.detail,
                "mend": line.mend,
            }
            for line in told.bad[:MOST_BAD]
        ]
        answer = {
            "alines": self.recording.planned,
            "samples": told.samples,
            "sampling_interval": told.sampling_interval,
            "looked_at": len(places),
            "complete": len(places) == self.recording.planned,
            "decidable": told.decidable,
            "histogram": {
                "kind": told.histogram_kind,
                "edges": told.edges,
                "counts": told.counts,
                "clipped_low": told.clipped_low,
                "clipped_high": told.clipped_high,
                "missing_codes": told.missing_codes,
                "mid_scale_offset": told.mid_scale_offset,
            },
            "spectrum": {
                "frequencies": told.frequencies,
                "mean": told.spectrum_mean,
                "median": told.spectrum_median,
            },
            "maps": maps,
            "beams": self._beams(),
            "frames": [self.statistics()],
            "bad": bad,
            "bad_counts": self.kinds,
        }
        return dict(to_jsonable(answer))

    def statistics(self) -> dict[str, Any]:
        """Return mean and standard deviation of power and baseline over the frame's A-lines, as a dictionary."""
        return dict(to_jsonable({"frame": self.frame, **self._statistics(slice(None))}))

    def _beams(self) -> list[dict[str, Any]]:
        beams = int(self.recording.provenance.get("beams", "1"))
        return [{"beam": beam, **self._statistics(self.rows % beams == beam)} for beam in range(beams)]

    def _statistics(self, those: NDArray[np.bool_] | slice) -> dict[str, Any]:
        power, baseline = self.signals.power[those], self.signals.baseline_mean[those]
        told: dict[str, Any] = {"alines": len(power)}
        if not len(power):
            return told
        told |= {"power": power.mean(dtype=float), "power_spread": power.std(dtype=float)}
        told |= {"baseline": baseline.mean(dtype=float), "baseline_spread": baseline.std(dtype=float)}
        if self.recording.shots is not None:
            told |= {"gain": self.recording.shots.gain[those].mean()}
            told |= {"delay": self.recording.shots.time_zero[those].mean()}
        return told


def inspect_scan(
    path: Path,
    frame: int = 0,
    *,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Inspection:
    """Inspect the A-lines stored so far in a frame of a scan, or in a recording of another supported format.

    Raises
    ------
    NotFound, DamagedFile, InvalidInput
        See :func:`steradian.scans.opening.open_recording`.
    Cancelled
        When ``cancelled`` returned ``True``.
    """
    recording = open_recording(path, frame)
    zeros = recording.time_zero if recording.shots is None else recording.shots.time_zero
    signals = inspect_signals(
        recording.traces,
        recording.sampling_interval,
        recording.positions,
        time_zero=zeros,
        scale=recording.scale,
        sound_speed=recording.sound_speed or 1500.0,
        progress=progress,
        cancelled=cancelled,
    )
    rows = recording.rows
    return Inspection(signals, recording, np.arange(len(recording.traces)) if rows is None else rows, frame)
