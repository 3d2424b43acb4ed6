"""A PostgreSQL, an object store, and how busy the machine is, for what is claimed in seconds."""

import time

import pytest

from support.postgres import running_postgres
from support.seaweed import running_seaweed


@pytest.fixture(scope="session")
def postgres():
    """A server of its own; skipped where the wheel is absent."""
    with running_postgres() as server:
        yield server


@pytest.fixture(scope="session")
def seaweed(tmp_path_factory):
    """An object store of its own, likewise."""
    with running_seaweed(tmp_path_factory.mktemp("seaweed")) as store:
        yield store


@pytest.fixture
def slowed():
    """Tell how many times longer than on an idle machine things take just now, from 1 on."""

    def slowed():
        begun, worked = time.perf_counter(), time.process_time()
        while (spent := time.process_time() - worked) < 0.1:
            pass
        return max(1.0, (time.perf_counter() - begun) / spent)

    return slowed
