"""A-lines of layered and attenuating media by k-wave-python's NumPy solver, for tests/data/media_kwave.npz.

k-wave-python is no dependency: install it beside Steradian (``pip install . k-wave-python``) and run

    python benchmarks/kwave_media.py tests/data/media_kwave.npz

Two-dimensional: a Gaussian disc below a line of sensors, in water over faster tissue of the same density, in soft
tissue, and in water over soft tissue. k-Wave's speed of sound is meant at the frequency 0 for powers above 1; the
speeds kept are those at 1 MHz.
"""

from __future__ import annotations

import sys
import urllib.request
from pathlib import Path

import numpy as np

WIDTH, DEPTH, SPACING = 320, 160, 25e-6
BOUNDARY, CENTRE, SIZE = 40, (8, 80), 90e-6
STEPS, INTERVAL, EVERY = 1040, 3e-9, 5
COEFFICIENT, POWER = 0.75, 1.5
MEDIA = {"layers": (1480.0, 1580.0, False, False), "lossy": (1520.0, 1520.0, True, True)}
MEDIA["lossy_layer"] = (1480.0, 1580.0, False, True)


def offline(*_args: object) -> None:
    """Stand in for the download of solver binaries at import, which this does not use."""
    raise TimeoutError


def simulate(above: float, below: float, lossy_above: bool, lossy_below: bool) -> np.ndarray:
    """Return the A-lines (sensors, samples) of a medium."""
    from kwave.kgrid import kWaveGrid
    from kwave.kmedium import kWaveMedium
    from kwave.ksensor import kSensor
    from kwave.ksource import kSource
    from kwave.kspaceFirstOrder import kspaceFirstOrder

    grid = kWaveGrid((DEPTH, WIDTH), (SPACING, SPACING))
    grid.setTime(STEPS, INTERVAL)
    deep = (np.arange(DEPTH) >= BOUNDARY)[:, None] * np.ones((1, WIDTH), bool)
    medium = kWaveMedium(sound_speed=np.where(deep, below, above), density=np.full((DEPTH, WIDTH), 1000.0))
    if lossy_above or lossy_below:
        medium.alpha_coeff = COEFFICIENT * np.where(deep, float(lossy_below), float(lossy_above))
        medium.alpha_power = POWER
    z, x = np.mgrid[:DEPTH, :WIDTH]
    source = kSource()
    squares = (z - CENTRE[1]) ** 2 + (x - WIDTH // 2 - CENTRE[0]) ** 2
    source.p0 = np.exp(-squares * SPACING**2 / 2 / SIZE**2)
    mask = np.zeros((DEPTH, WIDTH), bool)
    mask[0] = True
    found = kspaceFirstOrder(grid, medium, source, kSensor(mask=mask), smooth_p0=False, quiet=True)
    return np.asarray(found["p"])[::8, ::EVERY]


def main(path: str) -> None:
    """Simulate all media and write the file."""
    urllib.request.urlretrieve = offline
    traces = {name: simulate(*medium) for name, medium in MEDIA.items()}
    scale = max(float(np.abs(each).max()) for each in traces.values()) / 32_000
    np.savez_compressed(
        Path(path),
        **{name: np.round(each / scale).astype(np.int16) for name, each in traces.items()},
        scale=scale,
        dx=SPACING,
        dt=INTERVAL * EVERY,
        sensors=(np.arange(WIDTH)[::8] - WIDTH // 2) * SPACING,
        boundary=BOUNDARY * SPACING,
        centre=np.array(CENTRE) * SPACING,
        size=SIZE,
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
