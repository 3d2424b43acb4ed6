"""All connections to the database are busy: callers are told to come again, and the event stream goes on afterwards."""

import asyncio
from contextlib import ExitStack
from datetime import UTC, datetime

import httpx
import pytest

from steradian.api.app import create_app
from steradian.api.streaming.broadcaster import EventBroadcaster
from steradian.core.settings import Settings
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.repositories.event_log import append_event


@pytest.fixture
def app(tmp_path):
    settings = Settings.create(data=tmp_path)
    database = Database(metadata_url(settings))
    database.migrate()
    database.close()
    app = create_app(settings)
    pool = app.state.services.database.engine.pool
    pool._timeout = 0.2  # not thirty seconds
    yield app
    app.state.services.process_pool.close()
    app.state.services.close()


def take_all(services):
    """Take every connection there is; they are free again when the block ends."""
    pool, taken = services.database.engine.pool, ExitStack()
    for _ in range(pool.size() + pool._max_overflow):
        taken.enter_context(services.database.engine.connect())
    return taken


@pytest.mark.parametrize("path", ["masks", "masks/ma2899e71138a7671fcccea77", "jobs"])
def test_request_without_free_database_connection_returns_503_retry_after(app, path):
    async def ask():
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as http:
            return await http.get(f"/api/v1/{path}")

    with take_all(app.state.services):
        answer = asyncio.run(ask())
    assert (answer.status_code, answer.json()["code"]) == (503, "database-unavailable"), answer.text
    assert answer.headers["retry-after"] == "2"


def test_the_event_stream_goes_on_when_connections_are_free_again(app):
    services = app.state.services
    feed = EventBroadcaster(services)

    async def follow():
        taken = take_all(services)
        looks = 0
        async for _ in feed.subscribe():
            looks += 1
            if looks == 3:  # the first looks at the log were in vain
                taken.close()
                with services.database.write() as session:
                    append_event(session, datetime.now(UTC), "job", "j1", {"state": "queued"})
            if feed.last >= 1:
                return

    asyncio.run(asyncio.wait_for(follow(), 120))
    assert feed.last == 1


def test_event_stream_continues_after_unreadable_row(app, monkeypatch):
    services, understood = app.state.services, app.state.services.log.after
    feed = EventBroadcaster(services)

    def after(*asked):
        if not failed:
            failed.append(asked)
            raise ValueError("a row that nobody understands")
        return understood(*asked)

    failed = []
    monkeypatch.setattr(services.log, "after", after)

    async def follow():
        async for _ in feed.subscribe():
            if failed and feed.last == 0:
                with services.database.write() as session:
                    append_event(session, datetime.now(UTC), "job", "j1", {"state": "queued"})
            if feed.last >= 1:
                return

    asyncio.run(asyncio.wait_for(follow(), 120))
