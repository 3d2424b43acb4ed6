import numpy as np
import pytest

from steradian import ScanPlan, equi_steradian_mask
from support.alines import Aline


@pytest.fixture(scope="session")
def plan():
    return ScanPlan.create(mask=equi_steradian_mask(13.56e-3, 3.6e-3, 60), samples=256)


@pytest.fixture(scope="session")
def alines(plan):
    """One A-line of random samples per point, in visit order."""
    samples = np.random.default_rng(1).integers(-32768, 32767, (plan.mask.count, plan.samples), dtype=np.int16)
    return [Aline(point, row, point + 1, 0.5, dc_v=1.2) for point, row in enumerate(samples)]
