"""An API whose queue cannot be opened yet, because the data folder is not mounted: it says so and goes on trying."""

import httpx
import pytest

from steradian.core.settings import Settings
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.maintenance.folder_binding import bind_folder
from support.waiting import until

from .conftest import api_of


@pytest.mark.long
def test_job_queue_open_failure_is_retried_and_readiness_returns_503(tmp_path):
    data = DataDirectory(tmp_path)
    data.create()
    database = Database(metadata_url(Settings.create(data=tmp_path)))
    database.migrate()
    bind_folder(database, data)
    database.close()
    right = data.identity
    data.identity_file.write_text("0" * 32)

    server = api_of(tmp_path)
    try:
        until(lambda: "trying again in" in server.said, tell=lambda: server.said)
        server.wait()
        answer = httpx.get(f"{server.url}/readyz", timeout=250)
        checks = answer.json()["checks"]
        assert (answer.status_code, checks["queue"], checks["store"]) == (503, False, False)
        assert checks["database"]

        data.identity_file.write_text(right)
        until(lambda: httpx.get(f"{server.url}/readyz", timeout=250).json()["checks"]["queue"])
        assert httpx.get(f"{server.url}/readyz", timeout=250).json()["checks"]["store"]
    finally:
        server.close()
    assert "the job queue cannot be opened" in server.log
