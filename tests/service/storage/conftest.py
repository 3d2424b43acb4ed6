from datetime import UTC, datetime, timedelta

import pytest

from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.storage.database import Database
from steradian.storage.masks import MaskRepository
from steradian.storage.plans import PlanRepository


class Clock:
    """A clock that tests set."""

    def __init__(self):
        self.now = datetime(2026, 1, 2, 3, 4, 5, 678901, UTC)

    def __call__(self):
        return self.now

    def advance(self, **by):
        self.now += timedelta(**by)


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def database(tmp_path):
    database = Database(f"sqlite:///{tmp_path / 'test.sqlite'}")
    database.migrate()
    yield database
    database.close()


@pytest.fixture
def plan():
    mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=60)
    return ScanPlan.create(mask=mask, samples=256)


@pytest.fixture
def plan_row(database, clock, plan):
    MaskRepository(database, clock).put(plan.mask)
    return PlanRepository(database, clock).put(plan)[0]
