from dataclasses import dataclass

import numpy as np
import pytest

from steradian import ScanPlan, equi_steradian_mask


@dataclass
class Aline:
    """An A-line as a driver delivers it."""

    point: int
    samples: np.ndarray
    scale: float = 0.5
    energy: float = 1.0
    wavelength_m: float = 1.55e-6
    fire_time_s: float = 0.0
    quality: int = 0
    shot: int = 0
    averages: int = 1
    time_zero_offset_s: float = 0.0
    dc_v: float = 1.2
    gain_db: float = 0.0


@pytest.fixture(scope="session")
def plan():
    return ScanPlan.create(mask=equi_steradian_mask(13.56e-3, 3.6e-3, 60), samples=256)


@pytest.fixture(scope="session")
def alines(plan):
    """One A-line of random samples per point, in visit order."""
    samples = np.random.default_rng(1).integers(-32768, 32767, (plan.mask.count, plan.samples), dtype=np.int16)
    return [Aline(point, row, shot=point + 1) for point, row in enumerate(samples)]
