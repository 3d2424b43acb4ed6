"""Recording: A-lines in memory with sensor geometry and per-A-line metadata."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.validation import FloatArray


@dataclass(frozen=True, eq=False)
class ShotMetadata:
    """Per-A-line metadata: pulse energies, time zeros, bias wavelengths, flags.

    Attributes
    ----------
    energy
        (M,) mean pulse energy relative to nominal.
    time_zero
        (M,) time in seconds of each A-line's first column after its laser pulse.
    quality
        (M,) flags: 1 saturated, 2 mistuned, 4 misfire, 8 partial average.
    averages
        (M,) shots really averaged.
    level
        (M,) DC level of the interferometer in V.
    gain
        (M,) gain of the receiver in dB over its usual one; ``scale`` has taken it into account.
    sensitivity
        (M,) share of the film's best sensitivity that each A-line was read with; ``None``: not known.
    """

    energy: FloatArray
    time_zero: FloatArray
    quality: NDArray[np.uint32]
    averages: NDArray[np.uint32]
    level: FloatArray
    gain: FloatArray
    sensitivity: FloatArray | None = None

    @classmethod
    def default(cls, time_zero: FloatArray) -> ShotMetadata:
        """Return metadata with time zeros (M,) and default values for everything else."""
        count = len(time_zero)
        none, zeros = np.zeros(count, np.uint32), np.zeros(count)
        return cls(np.ones(count), time_zero, none, none + 1, zeros, zeros)

    def select(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> ShotMetadata:
        """Return the metadata of a subset of the A-lines."""
        values: dict[str, Any] = {each.name: getattr(self, each.name) for each in fields(self)}
        taken: dict[str, Any] = {name: None if value is None else value[index] for name, value in values.items()}
        return ShotMetadata(**taken)


@dataclass(frozen=True)
class Recording:
    """A-lines in memory with sensor positions, weights and times.

    Attributes
    ----------
    traces
        (M, N_t) A-lines; row m was sensed at ``positions[m]``, column n at time ``time_zero + n·sampling_interval``
        after the laser pulse. Integers count digitiser steps.
    scale
        (M,) or scalar: pressure per unit of ``traces``.
    positions
        (M, 2) metres, centred on the aperture; (M, 1) on a line.
    weights
        (M,) areas in m² whose sum is the sensed area, on a line lengths in m; ``None``: those of the sensors' cells.
    sampling_interval, sound_speed, aperture, time_zero
        Seconds, metres per second (``None`` when the file states none), metres, seconds. Where the A-lines differ in
        their time zero, which ``shots`` tells, it is the earliest.
    grid
        Voxels per axis at the pitch of an imported lattice that is finer than 60 µm or coarser than 0.5 mm; of others
        ``None``.
    centre
        Coordinates (x, y) in m of the aperture's centre in the frame of the file that the positions came from; () where
        that is ours.
    depth, offset
        Distance of the point of interest from the plane in metres, if there is one, and its (x, y).
    planned
        Number of points the plan asked for; more than M for a partial scan.
    missing
        (K, 2) metres: those that have no A-line; ``None`` where the file does not tell.
    provenance
        Identifiers of mask, plan, scan and scanner, for the volume's own record.
    shots
        What differed from A-line to A-line, where the file tells; ``None`` when nothing does any more
        (:func:`steradian.reconstructions.shot_normalisation.normalise_shots`).
    points
        (M,) numbers of the mask's points, where several A-lines belong to one because frames are to be averaged; else
        ``None``.
    notes
        What was decided or assumed when the recording was read or imported.
    rows
        (M,) number of each A-line in the scan file's array of A-lines, frame after frame; ``None``: no scan file.
    inspected
        Whether bad A-lines have been looked for and treated as was asked.
    sensitivity
        (M,) relative sensitivities by which the A-lines, ``scale`` included, were divided; ``None``: by none.
    times
        (M,) time of each A-line's shot in s since the first one; ``None``: not known, or a mean of frames.
    """

    traces: NDArray[np.number[Any]]
    scale: NDArray[np.float32] | float
    positions: FloatArray
    weights: FloatArray | None
    sampling_interval: float
    sound_speed: float | None
    aperture: float
    time_zero: float
    grid: int | None
    depth: float | None
    planned: int
    provenance: dict[str, str]
    shots: ShotMetadata | None = None
    outline: FloatArray | None = None
    """Convex outline of the sensed area (:class:`steradian.masks.Mask`), ``None`` where the file does not say: scans
    measured before it was kept have weights that sum to aperture², whatever their sensors cover."""
    missing: FloatArray | None = None
    offset: tuple[float, ...] = (0.0, 0.0)
    points: NDArray[np.int64] | None = None
    centre: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()
    rows: NDArray[np.int64] | None = None
    inspected: bool = False
    sensitivity: NDArray[np.float64] | None = None
    times: NDArray[np.float64] | None = None

    def select(self, wanted: NDArray[np.bool_]) -> Recording:
        """Return the recording of the A-lines in ``wanted`` (M,), with weights scaled to the same total."""
        weights, scale = self.weights, np.asarray(self.scale)
        if weights is not None:
            weights = weights[wanted] * (weights.sum() / weights[wanted].sum())
        return replace(
            self,
            traces=self.traces[wanted],
            scale=scale[wanted] if scale.ndim else self.scale,
            positions=self.positions[wanted],
            weights=weights,
            shots=None if self.shots is None else self.shots.select(wanted),
            points=None if self.points is None else self.points[wanted],
            rows=None if self.rows is None else self.rows[wanted],
            sensitivity=None if self.sensitivity is None else self.sensitivity[wanted],
            times=None if self.times is None else self.times[wanted],
        )

    def averaged(self, precision: FloatArray | None = None) -> Recording:
        """Return the recording with the weighted mean of the A-lines of each point; unchanged without ``points``.

        Their times must be equal, and what else differs from shot to shot must have been evened out. ``precision`` is
        the inverse of each A-line's noise variance, (M,); None: equal weights.
        """
        if self.points is None:
            return self
        order = np.argsort(self.points, kind="stable")
        _, first, counts = np.unique(self.points[order], return_index=True, return_counts=True)
        scale = np.broadcast_to(np.asarray(self.scale, np.float32), len(order))
        share = np.ones(len(order)) if precision is None else precision[order].astype(np.float64)
        share = (share / np.repeat(np.add.reduceat(share, first), counts)).astype(np.float32)
        mean = np.add.reduceat(self.traces[order] * (scale[order] * share)[:, None], first, axis=0)
        rows, weights = order[first], self.weights
        if weights is not None:
            weights = weights[rows] * (weights.sum() / weights[rows].sum())
        sensitivity = self.sensitivity
        if sensitivity is not None:
            sensitivity = np.sqrt(np.add.reduceat(sensitivity[order] ** 2, first) / counts)
        merged = replace(self, traces=mean, scale=1.0, positions=self.positions[rows], weights=weights)
        return replace(merged, shots=None, points=None, rows=None, sensitivity=sensitivity, times=None)
