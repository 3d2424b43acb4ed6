"""Server-sent event clients that verify the delivery of all events."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Sequence
from contextlib import aclosing, asynccontextmanager, suppress
from dataclasses import dataclass, field

from steradian.benchmarks.http_client import connect, format_head, parse_head

EVENTS = "/api/v1/events"
PATIENCE = 30.0
"""Seconds after the last event within which every listener is to have it."""


@dataclass
class EventListener:
    """Client of one event stream (server-sent events) that never reconnects.

    Attributes
    ----------
    url
        Of the service.
    after
        The event after which it begins, ``epoch.number``.
    numbers
        What it was told, as it came: first where the stream begins, then the number of each event.
    """

    url: str
    after: str
    numbers: list[int] = field(default_factory=list)
    _moved: asyncio.Event = field(default_factory=asyncio.Event, repr=False)

    async def follow(self) -> None:
        """Record received events until the stream ends."""
        async with aclosing(_places(self.url, self.after)) as places:
            async for place in places:
                self.numbers.append(_number(place))
                self._moved.set()

    async def wait_for(self, number: int) -> None:
        """Wait until a given event was received."""
        while number not in self.numbers:
            self._moved.clear()
            await self._moved.wait()


@dataclass(frozen=True)
class DeliveryReport:
    """Delivery counts of event listeners: received, missing and repeated events."""

    events: int
    lost: int
    again: int


@asynccontextmanager
async def open_listeners(urls: Sequence[str], streams: int) -> AsyncIterator[list[EventListener]]:
    """Open event streams at several services alternately, starting after the newest event."""
    begin = await newest(urls[0])
    listeners = [EventListener(urls[number % len(urls)], begin) for number in range(streams)]
    tasks = [asyncio.create_task(listener.follow()) for listener in listeners]
    try:
        yield listeners
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def compare(listeners: Sequence[EventListener]) -> DeliveryReport:
    """Compare the events received by each listener with the complete event log."""
    if not listeners:
        return DeliveryReport(0, 0, 0)
    log = EventListener(listeners[0].url, listeners[0].after)
    last = _number(await newest(log.url))
    reading = asyncio.create_task(log.follow())
    try:
        async with asyncio.timeout(PATIENCE):
            await log.wait_for(last)
    except TimeoutError:
        raise RuntimeError(f"the log could not be read as far as event {last}; what was lost is not known") from None
    finally:
        reading.cancel()
    with suppress(TimeoutError):
        async with asyncio.timeout(PATIENCE):
            await asyncio.gather(*(listener.wait_for(last) for listener in listeners))
    whole = {number for number in log.numbers if number <= last}
    heard = [[number for number in listener.numbers if number <= last] for listener in listeners]
    return DeliveryReport(
        events=sum(max(0, len(numbers) - 1) for numbers in heard),
        lost=sum(len(whole.difference(numbers)) for numbers in heard),
        again=sum(len(numbers) - len(set(numbers)) for numbers in heard),
    )


async def newest(url: str) -> str:
    """Return the position of the newest event, ``epoch.number``."""
    async with aclosing(_places(url)) as places:
        return await anext(places)


async def _places(url: str, after: str | None = None) -> AsyncGenerator[str, None]:
    """Yield the event ids of an event stream: the starting position, then one id per event."""
    reader, writer = await connect(url)
    try:
        headers = {} if after is None else {"Last_Event_ID": after}
        writer.write(format_head(url, EVENTS, "GET", None, **headers))
        await parse_head(reader)
        async for line in reader:
            if line.startswith(b"id: "):
                yield line[4:].decode().strip()
    finally:
        writer.close()


def _number(place: str) -> int:
    return int(place.rpartition(".")[2])
