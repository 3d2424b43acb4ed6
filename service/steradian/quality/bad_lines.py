"""Detection of bad A-lines by comparison with their nearest neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.progress import CancelCheck, Progress
from steradian.quality.neighbour_correlation import CorrelationStatistics, Neighbourhood, compare

NEIGHBOURS: Final = 6
ALIKE: Final = 0.35
"""Mean correlation among neighbours from which sign and lag are decided."""
MOSTLY: Final = 0.5
"""Share of A-lines with such neighbours from which the recording as a whole is said to be decidable."""
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
    """Bad A-line: its index, kind of defect, reason, and for a time-shifted one its delay in seconds."""

    aline: int
    kind: Kind
    detail: str
    shift: float = 0.0

    @property
    def mend(self) -> Mend:
        """Name of the repair for this kind of defect."""
        return MENDS[self.kind]


def find_bad_lines(
    low: NDArray[np.complex64],
    step: float,
    around: Neighbourhood,
    power: NDArray[np.float32],
    quiet: NDArray[np.float32],
    saturated: NDArray[np.bool_],
    time_zero: NDArray[np.float64],
    sound_speed: float,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> tuple[tuple[BadLine, ...], bool]:
    """Find dead, noisy, inverted, saturated and time-shifted A-lines.

    Parameters
    ----------
    low
        (n, F) lowest bins of the A-lines' spectra, whose inverse transform has 2·(F - 1) samples ``step`` s apart.
    power, quiet, saturated
        (n,) variance, variance of the quiet part, and whether it is flat at an extreme value.
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
    like = compare(low, step, around, time_zero, sound_speed, progress, cancelled)
    same = np.maximum(like.same, 0.02)
    usual, usual_elsewhere = around.median(like.same), around.median(like.elsewhere)
    decidable = (usual >= ALIKE) & (usual > 1.1 * usual_elsewhere)
    inverted = (like.opposite > 1.2 * same) & (like.opposite > np.maximum(0.6 * usual, like.elsewhere))
    far = (like.elsewhere > 1.5 * same) & (like.elsewhere > np.maximum(0.7 * usual, 1.1 * usual_elsewhere))
    slightly = (np.abs(like.near) > like.reach) & (like.same > 0.4 * usual) & (like.same < 0.7 * usual)
    slightly |= _outlying(like, around, step) & (like.same > 0.4 * usual)
    shifted = far | (slightly & (usual >= 1.5 * ALIKE))
    silent = like.power < 1.3 * like.floor + 0.1 * np.maximum(around.median(like.power) - like.floor, 0)
    dead = (same < 0.55 * usual) & silent & ~noisy & ~inverted & ~shifted
    found = {
        "dead": constant | (decidable & dead),
        "saturated": saturated & ~constant,
        "noisy": noisy,
        "inverted": decidable & inverted,
        "shifted": decidable & shifted,
    }
    details = {
        "dead": "far less signal than its neighbours",
        "saturated": "flat at its extreme value",
        "noisy": "far more noise than its neighbours",
        "inverted": "its neighbours' sign reversed",
        "shifted": "{:+.0f} ns against its neighbours",
    }
    return _as_lines(found, np.where(far, like.lag, like.near), details), bool(np.mean(decidable) >= MOSTLY)


def _outlying(like: CorrelationStatistics, around: Neighbourhood, step: float) -> NDArray[np.bool_]:
    """Return (n,) whether an A-line's lag to its neighbours is an outlier among its neighbours' lags.

    The lag has to exceed five robust standard deviations (1.4826 times the median absolute deviation) of all, three of
    its neighbours, twice the scatter among its own neighbours, and three samples.
    """
    off = np.abs(like.near - np.median(like.near[around.index], axis=1))
    nearby = np.median(off[around.index], axis=1)
    least = np.maximum(5 * 1.4826 * np.median(off), 3 * step)
    return np.asarray(off > np.maximum.reduce([np.full_like(off, least), 3 * 1.4826 * nearby, 2 * like.scatter]))


def _as_lines(
    found: dict[str, NDArray[np.bool_]], lag: NDArray[np.float64], details: dict[str, str]
) -> tuple[BadLine, ...]:
    """Return the list of bad A-lines; an A-line with several defects gets the first kind in ``found``."""
    bad: dict[int, BadLine] = {}
    for kind, those in found.items():
        for aline in np.flatnonzero(those).tolist():
            shift = float(lag[aline]) if kind == "shifted" else 0.0
            line = BadLine(aline, kind, details[kind].format(1e9 * shift), shift)  # type: ignore[arg-type]
            bad.setdefault(aline, line)
    return tuple(bad[aline] for aline in sorted(bad))
