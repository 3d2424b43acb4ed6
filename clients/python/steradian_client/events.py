"""Event stream of the service (server-sent events): decoder, and reconnection after interruptions."""

from __future__ import annotations

import json
import re
import time
from collections.abc import AsyncGenerator, Iterator, Mapping
from contextlib import aclosing
from typing import Any, Final

from steradian_client import routes
from steradian_client.errors import ConnectionFailed, ServiceError
from steradian_client.models import Event
from steradian_client.request_session import INITIAL_BACKOFF, LONGEST_PAUSE, RETRYABLE, RequestSession
from steradian_client.sync_async import Mode, Resource, dual_iterator

KEEPALIVE_TIMEOUT: Final = 30.0
"""Seconds without a sign of life, of which the service gives one every 15 s, after which a stream counts as broken."""
_LINE_END: Final = re.compile(rb"\r\n|\n|\r(?=.)", re.DOTALL)


class Decoder:
    """Incremental decoder of server-sent events (WHATWG HTML, 9.2.6)."""

    def __init__(self) -> None:
        self.last_id: str | None = None
        """Where to go on after a break."""
        self.retry = 1.0
        """Seconds that the service asks for before that."""
        self.reset()

    def reset(self) -> None:
        """Discard a partial event of an interrupted stream."""
        self._rest, self._kind = b"", "message"
        self._data: list[str] = []

    def feed(self, piece: bytes) -> Iterator[Event]:
        """Yield the events that a chunk of the stream completes."""
        *lines, self._rest = _LINE_END.split(self._rest + piece)
        for line in lines:
            if line:
                self._take(line.decode("utf-8", "replace"))
            elif (event := self._end()) is not None:
                yield event

    def _take(self, line: str) -> None:
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if name == "event":
            self._kind = value
        elif name == "data":
            self._data.append(value)
        elif name == "id" and "\0" not in value:
            self.last_id = value
        elif name == "retry" and value.isdecimal():
            self.retry = int(value) / 1000

    def _end(self) -> Event | None:
        kind, data = self._kind, "\n".join(self._data)
        self._kind, self._data = "message", []
        return Event(kind=kind, id=self.last_id, data=json.loads(data)) if data else None


async def follow(
    session: RequestSession, filters: Mapping[str, Any], last_id: str | None
) -> AsyncGenerator[Event | None, None]:
    """Yield events across reconnections, each change once, and ``None`` after every received chunk.

    Raises
    ------
    ServiceError
        When the service does not give the stream, at first or for longer than the session is patient.
    ConnectionFailed
        When it is away for longer than that.
    """
    decoder = Decoder()
    decoder.last_id = last_id
    heard, pause, was_open = time.monotonic(), INITIAL_BACKOFF, False
    while True:
        headers = {"Accept": "text/event-stream", "Cache-Control": "no-store"}
        headers |= {"Last-Event-ID": decoder.last_id} if decoder.last_id else {}
        try:
            more = {"params": filters, "headers": headers, "timeout": KEEPALIVE_TIMEOUT}
            async with session.open(routes.FOLLOW_EVENTS, {}, **more) as incoming:
                was_open, pause = True, INITIAL_BACKOFF
                async for piece in incoming.pieces:
                    heard = time.monotonic()
                    for event in decoder.feed(piece):
                        yield event
                    yield None
        except (ConnectionFailed, ServiceError) as error:
            passes = isinstance(error, ConnectionFailed) or error.status in RETRYABLE
            if not was_open or not passes or time.monotonic() - heard > session.patience:
                raise
        decoder.reset()
        await session.transport.sleep(max(pause, decoder.retry))
        pause = min(2 * pause, LONGEST_PAUSE)


class Events(Resource[Mode]):
    """Event stream of a service: live changes of state and progress."""

    @dual_iterator
    async def follow(
        self,
        *,
        kind: str | None = None,
        scan_id: str | None = None,
        progress: bool = True,
        last_event_id: str | None = None,
    ) -> AsyncGenerator[Event, None]:
        """Yield changes of state and progress; after an interruption, the stream resumes at the last event.

        Parameters
        ----------
        kind, scan_id
            Only changes of scans, reconstructions, revisions, jobs, batches or scanners; only what concerns one scan.
        progress
            Also progress, at most five times a second.
        last_event_id
            Go on after the event of that ``id``; ``None`` begins now.
        """
        filters = {"kind": kind, "scan_id": scan_id, "progress": progress}
        async with aclosing(follow(self._session, filters, last_event_id)) as events:
            async for event in events:
                if event is not None:
                    yield event
