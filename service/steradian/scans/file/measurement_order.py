"""Scan program: measurement order and parameters of a scan, from a plan or a scan file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from steradian.plans import ScanPlan

if TYPE_CHECKING:
    import h5py

    import fabry_perot


@dataclass(frozen=True, eq=False)
class ProgramSegment:
    """Rows of a scan file that are measured in one upload, at one excitation wavelength.

    Attributes
    ----------
    excitation
        Excitation wavelength in m; 0: as the laser stands.
    rows
        (K,) rows of the file, in the order of interrogation.
    """

    excitation: float
    rows: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ScanProgram:
    """Measurement order and parameters of a scan; row r of the file is point ``r % M`` in frame ``r // M``.

    Attributes
    ----------
    positions
        (M, 2) positions on the film in m.
    visit
        (M,) indices of points in the order of interrogation.
    excitation
        (F,) excitation wavelength of each frame in m; 0: as the laser stands.
    wavelengths
        (M,) bias wavelengths that are set, in m, or ``None`` for the scanner's own map.
    gate
        What waits for the gate: ``none``, the first point of each ``frame``, or every ``point``.
    samples, sampling_interval, pulse_rate, averages
        As in :class:`steradian.plans.ScanPlan`.
    """

    positions: NDArray[np.float64]
    visit: NDArray[np.int64]
    excitation: tuple[float, ...]
    wavelengths: NDArray[np.float64] | None
    samples: int
    sampling_interval: float
    pulse_rate: float
    averages: int
    gate: str = "none"
    beams: int = 1
    """How many beams record each place: points n·B … n·B + B − 1 are at the place of the first of them."""

    @classmethod
    def of_plan(cls, plan: ScanPlan) -> Self:
        """Return the scan program of a plan."""
        return cls(
            positions=plan.mask.film_positions,
            visit=plan.visit,
            excitation=plan.frame_excitation,
            wavelengths=plan.bias,
            samples=plan.samples,
            sampling_interval=plan.sampling_interval,
            pulse_rate=plan.pulse_rate,
            averages=plan.averages,
            gate=plan.gate,
            beams=plan.beam_count,
        )

    @classmethod
    def of_file(cls, file: h5py.File) -> Self:
        """Return the scan program of an open scan file."""
        plan, where = file["plan"], np.asarray(file["mask/positions"], dtype=np.float64)
        if where.shape[1] == 1:
            where = np.column_stack([where[:, 0], np.zeros(len(where))])
        return cls(
            positions=where,
            visit=np.asarray(plan["visit"], dtype=np.int64),
            excitation=tuple(np.asarray(plan["frame_excitation"]).tolist()),
            wavelengths=np.asarray(plan["bias"], dtype=np.float64) if "bias" in plan else None,
            samples=int(plan.attrs["samples"]),
            sampling_interval=float(plan.attrs["sampling_interval_s"]),
            pulse_rate=float(plan.attrs["pulse_rate_hz"]),
            averages=int(plan.attrs["averages"]),
            gate=str(plan.attrs["gate"]),
            beams=len(plan["beams"]) if "beams" in plan else 1,
        )

    @property
    def points(self) -> int:
        """Number of points of the mask, M."""
        return len(self.positions)

    @property
    def count(self) -> int:
        """Number of A-lines of all frames, F·M."""
        return len(self.excitation) * self.points

    @property
    def order(self) -> NDArray[np.int64]:
        """Rows of all frames in the order of interrogation (F·M,), frame after frame."""
        frames = np.arange(len(self.excitation), dtype=np.int64)[:, None] * self.points
        return (frames + self.visit).reshape(-1)

    def iter_segments(self, wanted: NDArray[np.bool_]) -> Iterator[ProgramSegment]:
        """Yield the ``wanted`` rows (F·M,) in the order of interrogation, split where the laser is retuned.

        All rows of a place are measured again where one is wanted: its beams share their shots.
        """
        rows, wanted = self.order, np.repeat(wanted.reshape(-1, self.beams).any(axis=1), self.beams)
        rows = rows[wanted[rows]]
        excitation = np.asarray(self.excitation)[rows // self.points]
        cuts = np.flatnonzero(np.diff(excitation)) + 1
        for piece in np.split(rows, cuts):
            if len(piece):
                yield ProgramSegment(self.excitation[int(piece[0]) // self.points], piece)

    def upload(
        self,
        scanner: fabry_perot.Scanner,
        rows: NDArray[np.int64],
        tag: int,
        *,
        averages: int | None = None,
        resume: bool = False,
        alone: bool = False,
    ) -> None:
        """Upload rows to a scanner in the given order; parameters as of :meth:`fabry_perot.Scanner.upload`.

        They are whole places; with ``alone`` any rows, which the first beam measures one by one.
        """
        beams = 1 if alone else self.beams
        rows = rows[::beams]
        points = rows % self.points
        scanner.upload(
            self.positions[points],
            samples=self.samples,
            sampling_interval=self.sampling_interval,
            pulse_rate=self.pulse_rate,
            averages=self.averages if averages is None else averages,
            wavelength=0.0 if self.wavelengths is None else self.wavelengths[points],
            gated=self.gated_points(rows),
            resume=resume,
            tag=tag,
            beams=beams,
        )

    def gated_points(self, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return a boolean array (K,): ``rows`` whose shots wait for the external gate signal."""
        frame = rows // self.points
        begins: NDArray[np.bool_] = np.diff(frame, prepend=-1) != 0
        if self.gate == "frame":
            return begins
        return np.full(len(rows), self.gate == "point")
