"""Event streams that come in a crowd are opened and refused a few at a time."""

import asyncio

from steradian.api.middleware.base import MAX_CONCURRENT_OPENS, STREAMS, StreamAdmissionMiddleware

CROWD = 200


def test_stream_admission_does_not_delay_other_requests():
    """All is asked in one moment; what each costs is counted, as it would be time."""
    answered = []

    async def inner(scope, _receive, send):
        if scope["path"] == STREAMS and scope["number"] % 2:
            await asyncio.sleep(0)  # one that is opened looks at the database; one that is refused waits for nothing
        answered.append(scope["path"])
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(_message):
        pass

    async def run():
        app = StreamAdmissionMiddleware(inner)
        scopes = [{"type": "http", "path": STREAMS, "number": number} for number in range(CROWD)]
        scopes.append({"type": "http", "path": "/healthz"})
        await asyncio.wait_for(asyncio.gather(*(app(scope, None, send) for scope in scopes)), 60)

    asyncio.run(run())
    assert answered.count(STREAMS) == CROWD
    assert answered.index("/healthz") <= MAX_CONCURRENT_OPENS


def test_a_stream_that_breaks_before_it_is_open_gives_its_turn_back():
    async def breaks(_scope, _receive, _send):
        raise ConnectionError

    async def run():
        app, scope = StreamAdmissionMiddleware(breaks), {"type": "http", "path": STREAMS}
        found = await asyncio.wait_for(
            asyncio.gather(*(app(scope, None, None) for _ in range(5 * MAX_CONCURRENT_OPENS)), return_exceptions=True),
            60,
        )
        assert all(isinstance(one, ConnectionError) for one in found)

    asyncio.run(run())
