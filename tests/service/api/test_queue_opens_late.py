"""An API whose queue cannot be opened yet, because the data folder is not mounted: it says so and goes on trying."""

import httpx
import pytest

from steradian.settings import Settings
from steradian.storage.database import Database, metadata_url
from steradian.storage.folder import bind
from steradian.storage.paths import DataDirectory
from support.waiting import until

from .conftest import api_of


@pytest.mark.long
def test_a_queue_that_cannot_be_opened_is_tried_again_and_readiness_says_so(tmp_path):
    data = DataDirectory(tmp_path)
    data.create()
    database = Database(metadata_url(Settings.create(data=tmp_path)))
    database.migrate()
    bind(database, data)
    database.close()
    right = data.identity
    data.identity_file.write_text("0" * 32)

    server = api_of(tmp_path)
    try:
        said = b""
        while b"trying again in" not in said:
            line = server.process.stderr.readline()
            assert line, f"it ended: {said.decode()}"
            said += line
        server.wait()
        answer = httpx.get(f"{server.url}/readyz", timeout=60)
        assert (answer.status_code, answer.json()["checks"]["queue"]) == (503, False)
        assert answer.json()["checks"]["database"]

        data.identity_file.write_text(right)
        until(lambda: httpx.get(f"{server.url}/readyz", timeout=60).json()["checks"]["queue"])
    finally:
        server.close()
    assert "the job queue cannot be opened" in said.decode() + server.log
