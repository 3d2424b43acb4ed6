"""A service that asks for a key, and nginx in front of it as ``docs/deploy.md`` shows it."""

import pytest

from support.nginx import Laboratory, needed
from support.services import Service

KEY = "a key for these tests alone"
BEARER = {"Authorization": f"Bearer {KEY}"}


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """A service on a simulated scanner that asks everybody for a key."""
    folder = tmp_path_factory.mktemp("service")
    service = Service(folder / "data", log=folder / "log", api_key=KEY, require_key=True).start()
    service.http.headers.update(BEARER)
    yield service
    service.close()


@pytest.fixture(scope="module")
def laboratory(service, tmp_path_factory):
    """nginx as documented, in front of it."""
    needed()
    laboratory = Laboratory(tmp_path_factory.mktemp("laboratory"), service.url)
    yield laboratory
    laboratory.close()


@pytest.fixture
def http(laboratory):
    """A client of the API through it."""
    with laboratory.client(headers=BEARER) as http:
        yield http
