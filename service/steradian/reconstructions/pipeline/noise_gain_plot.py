"""Plot of the noise gain of compensated attenuation against depth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from steradian.core.atomic_files import atomic_write


def draw_noise_gain(noise_gain: Sequence[tuple[float, float]], path: Path) -> None:
    """Plot the noise gain against depth, from pairs of depth in m and gain, as a PNG (atomic write)."""
    from matplotlib.figure import Figure

    depths, gains = np.array(noise_gain).T
    figure = Figure(figsize=(6.0, 3.6), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(1e3 * depths, gains, color="tab:blue")
    axes.set_ylim(bottom=0)
    axes.set_xlabel("depth (mm)")
    axes.set_ylabel("noise gain of the compensation")
    with atomic_write(path) as file:
        figure.savefig(file, format="png")
