"""Cancellation of a listener of the event log, in each of the event loop's turns beside a change."""

import asyncio

import pytest

from steradian.api.streaming.broadcaster import EventBroadcaster


@pytest.mark.parametrize("turns", range(6))
def test_listener_cancelled_just_after_a_change_ends(turns):
    async def listen(feed, heard):
        async for _ in feed.subscribe():
            heard.append(feed)

    async def run():
        feed, heard = EventBroadcaster(services=None), []
        feed._task = asyncio.get_running_loop().create_future()  # in place of the look at the database
        listener = asyncio.create_task(listen(feed, heard))
        for _ in range(3):  # until it waits for a change
            await asyncio.sleep(0)
        assert len(heard) == 1
        feed._moved.set()
        feed._moved = asyncio.Event()
        for _ in range(turns):
            await asyncio.sleep(0)
        listener.cancel()
        _, going_on = await asyncio.wait({listener}, timeout=1)
        for task in going_on:
            task.cancel()
        assert not going_on, "the client has left, and the stream goes on"
        assert feed._listeners == 0

    asyncio.run(run())
