"""``/events``: server-sent event stream of the event log."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncGenerator
from contextlib import aclosing
from dataclasses import dataclass
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from starlette.types import Receive, Scope, Send

from steradian.api.http.client_disconnect import wait_for_disconnect
from steradian.api.http.urls import link
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import CurrentPrincipal, ServicesDep
from steradian.api.services import ServiceContainer
from steradian.api.streaming.broadcaster import Event, EventBroadcaster, Progress
from steradian.security.keys import Principal
from steradian.storage.repositories.event_log import LogBounds

router = APIRouter(prefix=V1, tags=["events"], route_class=AuthorizedRoute)
BATCH = 200
"""Events that are read for one listener at a time."""
RETRY_MS = 1000
KEEPALIVE = 15.0
"""Seconds of silence after which a listener is told that the service is there."""
_STREAM = {"text/event-stream": {"schema": {"type": "string", "description": "Server-sent events"}}}
_SNAPSHOT = ("scans", "reconstructions", "jobs", "batches", "scanners")


@dataclass(frozen=True)
class EventFilter:
    """Subscription filter of an event stream: resource, kind and resume position."""

    kind: str | None
    scan_id: str | None
    with_progress: bool
    last_event_id: str | None

    def matches(self, one: Progress | Event) -> bool:
        """Return whether an event or a progress report passes the filter."""
        return self.kind in {None, one.kind} and self.scan_id in {None, one.scan_id}


async def _filter(
    kind: Annotated[
        Literal["scan", "reconstruction", "revision", "job", "batch", "scanner"] | None,
        Query(description="Only this kind"),
    ] = None,
    scan_id: Annotated[str | None, Query(max_length=64, description="Only events of this scan")] = None,
    progress: Annotated[bool, Query(description="Also progress, at most five times a second")] = True,
    last_event_id: Annotated[
        str | None,
        Query(max_length=100, description="Continue after this event, for clients that cannot set the header"),
    ] = None,
    last_event_id_header: Annotated[
        str | None, Header(alias="Last-Event-ID", description="Continue after this event: epoch.sequence")
    ] = None,
) -> EventFilter:
    return EventFilter(kind, scan_id, progress, last_event_id_header or last_event_id)


Wanted = Annotated[EventFilter, Depends(_filter)]


class EventStream(Response):
    """Streaming response of server-sent events that ends with its source or when its client disconnects."""

    media_type = "text/event-stream"

    def __init__(self, frames: AsyncGenerator[bytes, None]) -> None:
        # Proxies neither keep nor hold back what they pass on.
        super().__init__(headers={"Cache-Control": "no-cache", "X-Accel-Buffering": "no"})
        del self.headers["content-length"]
        self._frames = frames

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the event stream until it ends or the client disconnects."""
        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        telling, leaving = asyncio.create_task(self._tell(send)), asyncio.create_task(wait_for_disconnect(receive))
        try:
            await asyncio.wait({telling, leaving}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (telling, leaving):
                task.cancel()
            await asyncio.wait({telling, leaving})
        if not telling.cancelled():
            telling.result()

    async def _tell(self, send: Send) -> None:
        async with aclosing(self._frames) as frames:
            async for frame in frames:
                await send({"type": "http.response.body", "body": frame, "more_body": True})
        await send({"type": "http.response.body", "body": b""})


@router.get(
    "/events",
    status_code=200,
    summary="Event stream",
    response_class=EventStream,
    responses={200: {"description": "A stream that ends only when one side leaves", "content": _STREAM}},
)
async def follow_events(request: Request, services: ServicesDep, who: CurrentPrincipal, wanted: Wanted) -> EventStream:
    """Stream changes of state (events named scan, reconstruction, job, batch, scanner), revisions and progress.

    Changes carry ids; a client that sends the last one it saw as Last-Event-ID gets every later one exactly once, or
    one ``reset`` event when the log does not go back so far: then read the resources again. An id alone says that
    what happened up to it does not pass the filter. Progress carries no id and is not kept. A batch tells how its jobs
    stand whenever one of them moves on, a job when its priority is changed; with each such event, places in the queue
    may be others. A revision is a newer image of a scan that is followed: its id is the reconstruction's.
    """
    return EventStream(_stream_events(services, who, request.app.state.feed, wanted))


async def _stream_events(
    services: ServiceContainer, who: Principal, feed: EventBroadcaster, wanted: EventFilter
) -> AsyncGenerator[bytes, None]:
    bounds = await feed.log_bounds()
    cursor, problem = _resume_position(bounds, wanted.last_event_id)
    snapshot = {name: link(f"/{name}") for name in _SNAPSHOT}
    about = {} if problem is None else {"reason": problem, "snapshot": snapshot}
    name, place = "ready" if problem is None else "reset", f"{bounds.epoch}.{cursor}"
    yield format_sse_event(event=name, id=place, data_str=json.dumps(about), retry=RETRY_MS)
    told: dict[str, Progress] = {}
    began = spoke = time.monotonic()
    async with aclosing(feed.subscribe(progress=wanted.with_progress)) as changes:
        async for _ in changes:
            if services.keys.is_revoked(who):
                return
            frames, said = [], cursor
            while events := await feed.events_after(cursor, bounds.epoch, BATCH):
                cursor = events[-1].sequence
                if passing := [event for event in events if wanted.matches(event)]:
                    said, spoke = passing[-1].sequence, time.monotonic()
                    yield b"".join(event.frame for event in passing)  # at once: a client may have missed days
            if cursor > said:  # a client that comes back need not be told what it did not want to hear
                frames.append(format_sse_event(id=f"{bounds.epoch}.{cursor}"))
            for progress in feed.progress(since=began) if wanted.with_progress else ():
                if told.get(progress.id) != progress and wanted.matches(progress):
                    told[progress.id] = progress
                    frames.append(progress.sse_frame)
            if not frames and time.monotonic() - spoke >= KEEPALIVE:
                frames = [KEEPALIVE_COMMENT]
            if frames:
                spoke = time.monotonic()
                yield b"".join(frames)


def _resume_position(bounds: LogBounds, last_event_id: str | None) -> tuple[int, str | None]:
    """Return the event number after which a stream begins, and the reason if the client's last event is not usable."""
    if last_event_id is None:
        return bounds.last, None
    epoch, _, number = last_event_id.rpartition(".")
    if epoch != bounds.epoch or not (number.isascii() and number.isdecimal() and len(number) < 18):
        return bounds.last, "the id is of another log"
    if not bounds.before <= int(number) <= bounds.last:
        return bounds.last, "the log no longer holds the events after that id"
    return int(number), None
