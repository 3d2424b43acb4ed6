"""Detection of anomalies while A-lines are read: a common offset of the samples, constant A-lines."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from steradian.scans.importing.aline_blocks import Block, TraceBlocks
from steradian.scans.importing.import_remarks import remark

FloatArray = NDArray[np.float64]
AT_ONCE = 1 << 16
"""Samples that are looked at together."""
OFFSET = 0.5
"""An offset of all samples, in root mean squares of their variation, that is worth a remark."""
SHOWN = 5
"""So many constant A-lines are named."""


def noticed(table: TraceBlocks) -> Iterator[Block]:
    """Yield a table's blocks unchanged, and add import remarks on anomalies at the end."""
    count = lines = 0
    total = varied = 0.0
    constant: list[int] = []
    dead = 0
    for start, block in table.blocks():
        yield start, block
        means, power, silent = _moments(block)
        live = np.delete(np.arange(len(block)), silent)
        total, varied, count = total + means[live].sum(), varied + power[live].sum(), count + len(live)
        dead, lines = dead + len(silent), lines + len(block)
        constant += (start + silent[: SHOWN - len(constant)]).tolist()
    times = abs(total / count) / np.sqrt(varied / count) if count and varied > 0 else 0.0
    if times > OFFSET:
        remark(
            f"all samples have an offset of {total / count:.4g}, {times:.3g} times their variation, as a digitiser's "
            "mid-scale has; the option remove-offset takes it away"
        )
    if 0 < dead < lines:
        named = ", ".join(map(str, constant)) + (", …" if dead > len(constant) else "")
        remark(f"{dead} of {lines} A-lines are constant ({named}): dead channels count as sensors without signal")


def _moments(block: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.intp]]:
    """Return mean and variance of each A-line and the indices of constant A-lines."""
    step = max(1, AT_ONCE // max(1, block.shape[1]))
    means, power = np.empty(len(block)), np.empty(len(block))
    silent = np.empty(len(block), bool)
    with np.errstate(all="ignore"):
        for first in range(0, len(block), step):
            some = slice(first, first + step)
            values = block[some].astype(np.float64)
            means[some], power[some] = values.mean(axis=1), values.var(axis=1)
            silent[some] = np.ptp(values, axis=1) == 0
    return means, power, np.flatnonzero(silent)
