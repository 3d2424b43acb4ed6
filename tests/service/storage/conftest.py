from datetime import UTC, datetime, timedelta

import pytest
from obstore.store import S3Store

from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.storage.db.database import Database
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.plans import PlanRepository
from support.stores import psycopg_url, store_of


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


@pytest.fixture
def rows(postgres):
    """A database as a store has it."""
    database = Database(psycopg_url(postgres.database()))
    database.migrate()
    yield database
    database.close()


@pytest.fixture
def make_store(seaweed, rows):
    """Make a store on a data folder; a second one with the first's objects is another host's."""

    def make(folder, like=None, **settings):
        store = store_of(folder, seaweed, seaweed.bucket() if like is None else like.place, rows, **settings)
        if like is None:
            store.bind()
        return store

    return make


@pytest.fixture
def store(make_store, tmp_path):
    return make_store(tmp_path / "here")


@pytest.fixture
def objects(store, seaweed):
    """The bucket as it is, without names."""
    return S3Store.from_url(store.place, config={"endpoint": seaweed.endpoint}, client_options={"allow_http": True})
