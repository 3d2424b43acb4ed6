import pytest

from support.services import Service


@pytest.fixture(scope="session")
def url(tmp_path_factory):
    """Address of a running service with a simulated scanner."""
    service = Service(tmp_path_factory.mktemp("data")).start()
    yield service.url
    service.close()
