"""Layers of the measured line scan: widths and distances of its holes, and speeds found from starts 5 % off.

Run as ``python benchmarks/line_scan_layers.py FILE``, the file being LineScan2D_PinsPlexiAluSDH.mat of the Synaptus
toolbox (doi 10.21105/joss.04185), whose licence keeps it out of the repository: pulse-echo ultrasound through water,
acrylic and aluminium, here as an exploding reflector at half the speeds.
"""

from __future__ import annotations

import sys
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.signal import hilbert

import steradian
from steradian.reconstructions.studies.medium_search import FoundMedium

SPEEDS, THICKNESSES = (740.0, 1365.0, 3160.0), (73.3e-3, 31e-3, None)
"""Half the speeds of water, acrylic and aluminium in m/s, and thicknesses in m, as the file states them."""
INTERVAL, BEGIN, APERTURE = 80e-9, 58e-6, 111e-3
POSITIONS = (np.arange(111) - 55) * 1e-3
HOLES = {"acrylic": (76e-3, 101e-3, 3e-3), "aluminium": (108e-3, 150e-3, 6e-3)}
"""Depths in m between which the holes are, and the least distance of two."""

Floats = NDArray[np.float64]


def read(file: Path) -> Floats:
    """Return the A-lines (111, N_t) of the file."""
    return np.asarray(loadmat(file)["ptx"].T, np.float64)


def medium(factors: tuple[float, ...] = (1.0, 1.0, 1.0)) -> steradian.Medium:
    """Return the layers with their speeds multiplied by factors."""
    layers = zip(SPEEDS, factors, THICKNESSES, strict=True)
    return steradian.Medium([steradian.Layer(speed * factor, thickness) for speed, factor, thickness in layers])


def acquired(traces: Floats, layers: steradian.Medium) -> steradian.Acquisition:
    """Return the recording with a medium."""
    return steradian.Acquisition(traces, POSITIONS, dt=INTERVAL, t0=BEGIN, medium=layers, aperture=APERTURE)


def holes(volume: steradian.Volume, low: float, high: float, apart: float) -> tuple[Floats, Floats]:
    """Return depths and lateral -6 dB widths in m of the four largest envelopes between two depths."""
    x, z = volume.coordinates("x"), volume.coordinates("z")
    inside = (z > low) & (z < high)
    whole = np.abs(hilbert(np.asarray(volume.values), axis=1))
    left, found = whole[:, inside].copy(), []
    for _ in range(4):
        depth = z[inside][left.max(axis=0).argmax()]
        across = whole[:, np.abs(z - depth) < 2e-3].max(axis=1)
        top = int(across.argmax())
        half = across[top] / 2
        begin, end = top - int(np.argmax(across[top::-1] < half)), top + int(np.argmax(across[top:] < half))
        edges = [np.interp(half, across[[i, j]], x[[i, j]]) for i, j in ((begin, begin + 1), (end, end - 1))]
        found.append((depth, edges[1] - edges[0]))
        left[:, np.abs(z[inside] - depth) < apart] = 0
    depths, widths = np.array(sorted(found)).T
    return depths, widths


def search(traces: Floats, factors: tuple[float, ...], names: list[str] | None = None) -> FoundMedium:
    """Return the medium found from the stated one with its speeds multiplied by factors."""
    return steradian.find_medium(acquired(traces, medium(factors)), names, modes=111)


def main(file: Path) -> None:
    """Print the figures."""
    traces = read(file)
    grid = steradian.ImageGrid(modes=111, depth=(30e-3, 160e-3), lateral_padding=2.0)
    volume = steradian.reconstruct(acquired(traces, medium()), grid, steradian.Nufft(max_frequency=4e6))
    for name, where in HOLES.items():
        depths, widths = holes(volume, *where)
        print(name, "widths", np.round(1e3 * widths, 2), "mm, distances", np.round(1e3 * np.diff(depths), 2), "mm")
    starts = [(way,) * 3 for way in (1.05, 0.95)]
    starts += [tuple(way if i == j else 1.0 for j in range(3)) for way, i in product((1.05, 0.95), range(3))]
    for factors in starts:
        moved = [f"layer{i + 1}.sound_speed" for i, factor in enumerate(factors) if factor != 1]
        found = search(traces, factors, moved)
        for each in found.parameters:
            true = SPEEDS[int(each.name[5]) - 1]
            off = [100 * (value / true - 1) for value in (each.start, each.value)]
            error = 100 * (each.standard_error or 0.0) / true
            print(f"{len(moved)} at once, {each.name}: start {off[0]:+.1f} %, found {off[1]:+.2f} ± {error:.2f} %"
                  f" by {each.criterion}")  # fmt: skip


if __name__ == "__main__":
    main(Path(sys.argv[1]))
