"""``/events``: the event log as a stream (server-sent events), and tickets for browsers."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import aclosing
from dataclasses import asdict
from typing import Annotated, Literal

from anyio import CancelScope
from fastapi import APIRouter, Depends, Header, Query, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.dependencies import ServicesNeeded, Who
from steradian.api.feed import Feed, Progress
from steradian.api.security import V1, GuardedRoute
from steradian.api.services import Services
from steradian.api.views import BASE
from steradian.security.keys import TICKET_SECONDS
from steradian.storage.events import Bounds
from steradian.storage.tables import EventRow

router = APIRouter(prefix=V1, tags=["events"], route_class=GuardedRoute)
BATCH = 200
"""Events that one listener holds at a time."""
RETRY_MS = 1000
_SNAPSHOT = {name: f"{BASE}/{name}" for name in ("scans", "reconstructions", "jobs", "batches", "scanners")}


class TicketView(BaseModel):
    """A ticket for one event stream."""

    ticket: str = Field(
        description="Send it as ?ticket=…; it opens one stream, to which its client may come back with Last-Event-ID",
        examples=["Zk9…"],
    )
    seconds: float = Field(description="For how long it waits for its stream to be opened", examples=[TICKET_SECONDS])


class Filter:
    """Which events a listener wants, and after which one."""

    def __init__(
        self,
        kind: Annotated[
            Literal["scan", "reconstruction", "job", "batch", "scanner"] | None, Query(description="Only this kind")
        ] = None,
        scan_id: Annotated[str | None, Query(max_length=64, description="Only what concerns this scan")] = None,
        progress: Annotated[bool, Query(description="Also progress, at most five times a second")] = True,
        last_event_id: Annotated[
            str | None,
            Query(max_length=100, description="Go on after this event, for clients that cannot set the header"),
        ] = None,
        last_event_id_header: Annotated[
            str | None, Header(alias="Last-Event-ID", description="Go on after this event: epoch.sequence")
        ] = None,
    ) -> None:
        self.kind, self.scan_id, self.with_progress = kind, scan_id, progress
        self.last_event_id = last_event_id_header or last_event_id

    def wants(self, progress: Progress) -> bool:
        """Whether a piece of progress passes."""
        return self.with_progress and self.kind in {None, progress.kind} and self.scan_id in {None, progress.scan_id}

    def wants_event(self, event: EventRow) -> bool:
        """Whether an event passes."""
        return self.kind in {None, event.kind} and self.scan_id in {None, event.scan_id}


async def _feed(
    request: Request, services: ServicesNeeded, wanted: Annotated[Filter, Depends()]
) -> AsyncIterator[Feed]:
    """Open the stream of a ticket, which opens it again for a client that shows an event of it."""
    feed: Feed = request.app.state.feed
    ticket: str | None = getattr(request.state, "ticket", None)
    if ticket is None:
        yield feed
        return
    bounds = await run_in_threadpool(services.log.bounds)
    goes_on = wanted.last_event_id is not None and _begin(bounds, wanted.last_event_id)[1] is None
    await run_in_threadpool(services.keys.open_stream, ticket, goes_on=goes_on)
    try:
        yield feed
    finally:
        with CancelScope(shield=True):  # also when the client has left
            await run_in_threadpool(services.keys.close_stream, ticket)


@router.post("/tickets", status_code=201, summary="Get a ticket for one event stream")
def create_ticket(services: ServicesNeeded, who: Who) -> TicketView:
    """Make a ticket: a browser's EventSource can send no key, and a key does not belong into a URL."""
    return TicketView(ticket=services.keys.issue_ticket(who), seconds=TICKET_SECONDS)


@router.get(
    "/events",
    summary="What happens, as it happens",
    response_class=EventSourceResponse,
    responses={200: {"description": "A stream that ends only when one side leaves"}},
)
async def follow_events(
    services: ServicesNeeded, who: Who, feed: Annotated[Feed, Depends(_feed)], wanted: Annotated[Filter, Depends()]
) -> AsyncIterator[ServerSentEvent]:
    """Follow changes of state (events named scan, reconstruction, job, batch, scanner) and progress.

    Changes carry ids; a client that sends the last one it saw as Last-Event-ID gets every later one exactly once, or
    one ``reset`` event when the log does not go back so far: then read the resources again. An id alone says that
    what happened up to it does not pass the filter. Progress carries no id and is not kept.
    """
    bounds = await run_in_threadpool(services.log.bounds)
    cursor, problem = _begin(bounds, wanted.last_event_id)
    if problem is not None:
        data = {"reason": problem, "snapshot": _SNAPSHOT}
        yield ServerSentEvent(event="reset", id=f"{bounds.epoch}.{cursor}", data=data, retry=RETRY_MS)
    else:
        yield ServerSentEvent(event="ready", id=f"{bounds.epoch}.{cursor}", data={}, retry=RETRY_MS)
    told: dict[str, Progress] = {}
    said = cursor
    async with aclosing(feed.listen()) as changes:
        async for _ in changes:
            if services.keys.is_revoked(who):
                return
            while events := await _next(services, feed, cursor):
                cursor = events[-1].sequence
                for event in filter(wanted.wants_event, events):
                    said = event.sequence
                    yield _to_sse(event, bounds.epoch)
            if cursor > said:  # a client that comes back need not be told what it did not want to hear
                said = cursor
                yield ServerSentEvent(id=f"{bounds.epoch}.{cursor}")
            for progress in list(feed.progress.values()):
                if wanted.wants(progress) and told.get(progress.id) != progress:
                    told[progress.id] = progress
                    yield ServerSentEvent(event="progress", data=asdict(progress))


async def _next(services: Services, feed: Feed, cursor: int) -> list[EventRow]:
    """Read on after an event: in what all listeners share, or in the log."""
    shared = feed.after(cursor)
    return shared if shared is not None else await run_in_threadpool(services.log.after, cursor, BATCH)


def _begin(bounds: Bounds, last_event_id: str | None) -> tuple[int, str | None]:
    """Tell after which event a stream begins, and why that is not where the client left off."""
    if last_event_id is None:
        return bounds.last, None
    epoch, _, number = last_event_id.rpartition(".")
    if epoch != bounds.epoch or not (number.isascii() and number.isdecimal() and len(number) < 18):
        return bounds.last, "the id is of another log"
    if not bounds.before <= int(number) <= bounds.last:
        return bounds.last, "the log does not hold what came after that id"
    return int(number), None


def _to_sse(event: EventRow, epoch: str) -> ServerSentEvent:
    data = {"id": event.resource_id, "at": event.at.isoformat(), **event.data}
    return ServerSentEvent(event=event.kind, id=f"{epoch}.{event.sequence}", data=data)
