"""Disk space is checked on the node that does the work."""

from contextlib import nullcontext

import pytest

from steradian.api.app import create_app
from steradian.core.exceptions import DiskFull

from .conftest import api_of


@pytest.mark.parametrize(
    ("role", "for_scan", "is_refused"),
    [("api", True, False), ("acquisition", True, True), ("acquisition", False, False), ("service", False, True)],
)
def test_disk_space_is_required_of_the_node_that_writes(tmp_path, role, for_scan, is_refused):
    """A scan is written where its scanner is; jobs are written where the workers are."""
    server = api_of(tmp_path)
    services = create_app(server.settings.model_copy(update={"role": role})).state.services
    try:
        with pytest.raises(DiskFull) if is_refused else nullcontext():
            services.require_disk_space(2**60, "the work", for_scan=for_scan)
    finally:
        services.database.close()
        server.close()
