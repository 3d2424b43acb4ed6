"""Bad A-lines found by comparison with their nearest neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.errors import Cancelled
from steradian.progress import IsCancelled, Progress

NEIGHBOURS: Final = 6
CHUNK: Final = 2048
FLAT_RUN: Final = 4
"""Samples in a row at an A-line's extreme value from which it is saturated, if its neighbours have shorter runs."""
NOISY: Final = 4.0
"""Quiet variance over that of the neighbours from which an A-line is noisy."""
Kind = Literal["dead", "noisy", "inverted", "saturated", "shifted"]
Mend = Literal["leave-out", "sign", "shift"]
MENDS: Final[dict[Kind, Mend]] = {
    "dead": "leave-out",
    "noisy": "leave-out",
    "saturated": "leave-out",
    "inverted": "sign",
    "shifted": "shift",
}


@dataclass(frozen=True)
class BadLine:
    """A bad A-line: its index, its kind, why, and for a shifted one by how many seconds it is late."""

    aline: int
    kind: Kind
    detail: str
    shift: float = 0.0

    @property
    def mend(self) -> Mend:
        """What would mend it."""
        return MENDS[self.kind]


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """(n, k) indices of each sensor's nearest others, and (n, k) distances in metres."""

    index: NDArray[np.int64]
    distance: NDArray[np.float64]

    @classmethod
    def of(cls, positions: NDArray[np.float64], most: int) -> Neighbourhood:
        """Find up to ``most`` neighbours of sensors at positions (n, d)."""
        from scipy.spatial import cKDTree

        near = min(most, len(positions) - 1)
        distance, index = cKDTree(positions).query(positions, near + 1, workers=2)
        distance, index = (np.asarray(each).reshape(len(positions), -1) for each in (distance, index))
        own = index == np.arange(len(index))[:, None]
        own[~own.any(axis=1), -1] = True  # many at one place: the sensor itself may not be among them
        return cls(index[~own].reshape(len(index), near), distance[~own].reshape(len(index), near))

    def median(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return (n,) medians over each sensor's neighbours of values (n,)."""
        return np.asarray(np.median(values[self.index], axis=1))


def find_bad_lines(
    low: NDArray[np.complex64],
    step: float,
    around: Neighbourhood,
    power: NDArray[np.float32],
    quiet: NDArray[np.float32],
    runs: NDArray[np.int64],
    time_zero: NDArray[np.float64],
    sound_speed: float,
    progress: Progress | None = None,
    cancelled: IsCancelled | None = None,
) -> tuple[tuple[BadLine, ...], bool]:
    """Find dead, noisy, inverted, saturated and time-shifted A-lines.

    Parameters
    ----------
    low
        (n, F) lowest bins of the A-lines' spectra, whose inverse transform has 2·(F - 1) samples ``step`` s apart.
    power, quiet, runs
        (n,) variance, variance of the quiet part, and longest run of samples at the extreme value.
    time_zero
        (n,) seconds of the first sample.

    Returns
    -------
    tuple
        Bad A-lines by index, and whether neighbours are alike enough to compare sign and lag.
    """
    if around.index.shape[1] < 3:
        return _as_lines({"dead": power == 0}, np.zeros(len(power)), {"dead": "constant"}), False
    usual_power, usual_quiet = around.median(power), around.median(quiet)
    floor = 1e-4 * float(np.median(power)) + 1e-30
    constant = power <= 1e-6 * usual_power
    noisy = (quiet + floor) > NOISY * (usual_quiet + floor)
    saturated = runs >= np.maximum(FLAT_RUN, 3 * np.median(runs))
    peak, late = _compare(low, step, around, time_zero, progress, cancelled)
    size, sign, lag = np.median(np.abs(peak), axis=1), np.median(np.sign(peak), axis=1), np.median(late, axis=1)
    typical, samples = float(np.median(size)), 2 * (low.shape[1] - 1)
    decidable = typical >= max(0.4, 5 / np.sqrt(samples))
    usual_size = np.where(around.median(size) >= 0.6 * typical, around.median(size), 0)  # faint places have none
    plausible = around.distance.max(axis=1) / sound_speed + 2 * step
    spread = 1.4826 * float(np.median(np.abs(lag - np.median(lag))))
    alike = size >= 0.6 * typical
    found = {
        "dead": constant | (decidable & (size < 0.6 * usual_size) & (power < 0.6 * usual_power) & ~noisy),
        "saturated": saturated & ~constant,
        "noisy": noisy,
        "inverted": decidable & alike & (sign < 0) & (np.abs(lag) <= plausible),
        "shifted": decidable & alike & (sign > 0) & (np.abs(lag) > np.maximum(plausible, 6 * spread)),
    }
    details = {
        "dead": "far less signal than its neighbours",
        "saturated": "flat at its extreme value",
        "noisy": "far more noise than its neighbours",
        "inverted": "its neighbours' sign reversed",
        "shifted": "{:+.0f} ns against its neighbours",
    }
    return _as_lines(found, lag, details), bool(decidable)


def _as_lines(
    found: dict[str, NDArray[np.bool_]], lag: NDArray[np.float64], details: dict[str, str]
) -> tuple[BadLine, ...]:
    """List A-lines; of several kinds, the first in ``found`` counts."""
    bad: dict[int, BadLine] = {}
    for kind, those in found.items():
        for aline in np.flatnonzero(those).tolist():
            shift = float(lag[aline]) if kind == "shifted" else 0.0
            line = BadLine(aline, kind, details[kind].format(1e9 * shift), shift)  # type: ignore[arg-type]
            bad.setdefault(aline, line)
    return tuple(bad[aline] for aline in sorted(bad))


def _compare(
    low: NDArray[np.complex64],
    step: float,
    around: Neighbourhood,
    time_zero: NDArray[np.float64],
    progress: Progress | None,
    cancelled: IsCancelled | None,
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return (n, k) largest correlations with each neighbour, signed, and (n, k) seconds of lateness there."""
    from scipy.fft import irfft

    low = low.copy()
    low[:, :3] = 0  # slow drifts
    low[:, -1] = 0
    norm = np.sqrt(2 * np.sum(np.abs(low) ** 2, axis=1))
    low /= np.maximum(norm, 1e-30)[:, None]
    samples = 2 * (low.shape[1] - 1)
    peak = np.zeros(around.index.shape, np.float32)
    late = np.zeros(around.index.shape)
    for first in range(0, len(low), CHUNK):
        if cancelled is not None and cancelled():
            raise Cancelled("cancelled during: inspect A-lines")
        some = slice(first, first + CHUNK)
        for rank, others in enumerate(around.index[some].T):
            across = irfft(low[some] * np.conj(low[others]), samples, axis=1, workers=2) * samples
            at = np.abs(across).argmax(axis=1)
            peak[some, rank] = across[np.arange(len(at)), at]
            late[some, rank] = step * ((at + samples // 2) % samples - samples // 2)
            late[some, rank] += time_zero[some] - time_zero[others]
        if progress is not None:
            progress("compare neighbours", min(first + CHUNK, len(low)), len(low))
    return peak, late
