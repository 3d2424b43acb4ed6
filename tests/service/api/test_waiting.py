"""Those who wait for a job share one look at the event log, and hear of its end at once."""

import asyncio
import time
from types import SimpleNamespace

from steradian.api.params.dependencies import LongPoll
from steradian.api.services import ServiceContainer
from steradian.api.streaming.broadcaster import EventBroadcaster
from steradian.core.settings import Settings
from steradian.jobs.job import JobRequest


class Present:
    """A request whose client stays."""

    def __init__(self, feed):
        self.app, self.state = SimpleNamespace(state=SimpleNamespace(feed=feed)), SimpleNamespace()

    async def is_disconnected(self):
        return False


def test_forty_waiters_look_seldom_and_hear_of_the_end(tmp_path):
    services = ServiceContainer(Settings.create(data=tmp_path))
    services.data.create()
    services.database.migrate()
    with services.database.write() as session:
        services.ledger.add(session, JobRequest("j1", "export", {}))
    looks = []

    def look():
        looks.append(time.monotonic())
        return services.ledger.status("j1")

    async def run():
        request = Present(EventBroadcaster(services))
        waiting = [LongPoll(request, 120).wait_for(look, lambda job: job.is_over) for _ in range(40)]
        waiting = asyncio.gather(*waiting)
        await asyncio.sleep(4)
        assert not waiting.done()
        idle = len(looks)
        await asyncio.to_thread(services.ledger.request_cancellation, "j1", "test", None)
        await asyncio.to_thread(services.ledger.cancelled, "j1", "test")
        seen = await waiting
        assert {job.state for job in seen} == {"cancelled"}
        seen = await LongPoll(request, 0.5).wait_for(look, lambda job: False)
        assert seen.state == "cancelled", "whose time is up gets what is there"
        return idle

    try:
        idle = asyncio.run(run())
    finally:
        services.close()
    assert idle <= 40 * 6, "four seconds of nothing cost each at most six looks, not one every tenth of a second"


def test_event_subscription_without_progress_skips_job_polling(tmp_path, monkeypatch):
    services = ServiceContainer(Settings.create(data=tmp_path))
    services.data.create()
    services.database.migrate()
    looks, plain = [], services.ledger.unfinished
    monkeypatch.setattr(services.ledger, "unfinished", lambda: looks.append(1) or plain())
    feed = EventBroadcaster(services)

    async def hear(progress):
        async for _ in feed.subscribe(progress=progress):
            if progress and not looks:
                continue
            return await asyncio.sleep(0 if progress else 1)

    try:
        asyncio.run(hear(False))
        assert not looks
        asyncio.run(asyncio.wait_for(hear(True), 60))
        assert looks
    finally:
        services.close()
