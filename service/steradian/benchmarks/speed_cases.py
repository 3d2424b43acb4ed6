"""Test cases of the speed benchmark."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from steradian.imaging import DirectMethod, LinearKappa, Nufft
from steradian.masks import equi_steradian_mask

YARN = 13.56e-3  # m, side of the paper's yarn scan: 226 × 60 µm
INTERVAL = 8e-9  # s
SPEED = 1480.0  # m/s


@dataclass(frozen=True, slots=True)
class Case:
    """Test case of the speed benchmark: sensors, modes, samples and options of one reconstruction.

    Parameters
    ----------
    name
        What it stands for.
    sensors
        How they lie: on a grid, anywhere, by the equi-steradian rule, or on a line.
    count
        Sensors a side of the grid, else in all.
    modes, samples
        Of the reconstruction.
    aperture
        In metres.
    method
        Direct method.
    depth
        First and last depth in metres; None: all of the record.
    limit, one_shot_limit
        Ratios to the yardstick, of a run and of a call with its plan, that must not be exceeded; None: for information.
    part_limit
        Ratio of a run to that of the first case of the same shape, that must not be exceeded; None: for information.
    """

    name: str
    sensors: Literal["grid", "anywhere", "equi-steradian", "line", "line-anywhere"]
    count: int
    modes: int
    samples: int = 1024
    aperture: float = YARN
    method: DirectMethod = Nufft()
    depth: tuple[float, float] | None = None
    limit: float | None = None
    one_shot_limit: float | None = None
    part_limit: float | None = None

    def positions(self) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Return sensor positions in metres, (M, 2) or (M,), and weights or None."""
        rng = np.random.default_rng(0)
        axis = (np.arange(self.count) - self.count // 2) * self.aperture / self.count
        if self.sensors == "line":
            return axis, None
        if self.sensors == "line-anywhere":
            return (rng.random(self.count) - 0.5) * self.aperture, None
        if self.sensors == "grid":
            return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2), None
        if self.sensors == "anywhere":
            return (rng.random((self.count, 2)) - 0.5) * self.aperture, None
        mask = equi_steradian_mask(self.aperture, 3.6e-3, self.count)
        return np.asarray(mask.positions, np.float64), np.asarray(mask.weights, np.float64)


def speed_cases(*, quick: bool = False) -> list[Case]:
    """Return the test cases of the speed benchmark; ``quick``: with 1/64 of the volume."""
    below, depth = Nufft(max_frequency=20e6), (1e-3, 4e-3)
    full = [
        Case("yarn, equi-steradian", "equi-steradian", 1600, 226, limit=0.55, one_shot_limit=0.75),
        Case("yarn, equi-steradian, a record of 1,021", "equi-steradian", 1600, 226, samples=1021, part_limit=1.3),
        Case("yarn, equi-steradian, below 20 MHz", "equi-steradian", 1600, 226, method=below, part_limit=0.45),
        Case("yarn, equi-steradian, depths 1 to 4 mm", "equi-steradian", 1600, 226, depth=depth),
        Case("yarn, as many anywhere", "anywhere", 51076, 226, limit=0.9),
        Case("yarn, all on the grid", "grid", 226, 226, limit=0.7),
        Case("yarn, all on the grid, linear", "grid", 226, 226, method=LinearKappa()),
        Case("sizes without large factors", "equi-steradian", 1600, 256, limit=0.55, one_shot_limit=0.75),
        Case("line, 1024 sensors", "line", 1024, 1024),
        Case("line, 256 sensors anywhere", "line-anywhere", 256, 1024),
        Case("growth: modes ÷ 2", "equi-steradian", 1600, 113),
        Case("growth: samples ÷ 2", "equi-steradian", 1600, 226, samples=512),
        Case("growth: modes × 2", "equi-steradian", 1600, 512),
    ]
    if not quick:
        return full
    small = []
    for case in full:
        count = case.count // 4 if case.sensors in ("grid", "line") else case.count // 16
        count = max(count, 100) if case.sensors == "equi-steradian" else count
        part = None if case.depth is None else (case.depth[0] / 4, case.depth[1] / 4)
        modes, samples = case.modes // 4, case.samples // 4
        small.append(Case(case.name, case.sensors, count, modes, samples, case.aperture, case.method, part))
    return small
