"""Who looks at a preview waits for nobody's first pictures."""

import asyncio

import httpx
import pytest

from steradian.api.app import create_app
from steradian.core.settings import Settings
from steradian.storage.db.database import Database, metadata_url

from .conftest import EQUI

pytestmark = [pytest.mark.long, pytest.mark.timeout(400)]
WAIT = 120


def test_preview_is_not_blocked_by_stored_picture_drawing(tmp_path):
    settings = Settings.create(data=tmp_path)
    database = Database(metadata_url(settings))
    database.migrate()
    database.close()
    app = create_app(settings)
    services = app.state.services

    async def run():
        transport = httpx.ASGITransport(app=app)
        async with (
            httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as http,
            services.drawing,
        ):
            asking = http.post("/api/v1/masks/preview", json=EQUI, headers={"Accept": "image/png"})
            return await asyncio.wait_for(asking, WAIT)

    try:
        answer = asyncio.run(run())
    finally:
        services.process_pool.close()
        services.database.close()
    assert answer.status_code == 200, answer.text
    assert answer.content.startswith(b"\x89PNG")
