"""What handlers may ask for, bundled as types."""

from __future__ import annotations

import asyncio
import hashlib
import re
import time
from collections.abc import Callable
from typing import Annotated, TypeAlias, TypeVar

from fastapi import Depends, Header, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from steradian.api.services import Services
from steradian.errors import InvalidInput

MAX_WAIT = 120.0
"""Longest that a request is held (s); the client asks again."""
LOOK = 0.1
_WAIT_HELP = f"'wait=SECONDS' (RFC 7240) holds the answer until the work is over, {MAX_WAIT:g} s at most"

T = TypeVar("T")


def _services(request: Request) -> Services:
    services: Services = request.app.state.services
    return services


class Patience:
    """How long the client of a request is ready to wait."""

    def __init__(self, request: Request, seconds: float) -> None:
        self._request, self.seconds = request, seconds

    async def until(self, look: Callable[[], T], is_over: Callable[[T], bool]) -> T:
        """Look, in a thread, until what is seen is over, the time is up or the client has left."""
        deadline = time.monotonic() + self.seconds
        while True:
            seen = await run_in_threadpool(look)
            left = deadline - time.monotonic()
            if left <= 0 or is_over(seen) or await self._request.is_disconnected():
                return seen
            await asyncio.sleep(min(LOOK, left))


def _wait(
    request: Request, response: Response, prefer: Annotated[list[str] | None, Header(description=_WAIT_HELP)] = None
) -> Patience:
    for preference in ",".join(prefer or []).split(","):
        found = re.fullmatch(r"\s*wait\s*=\s*\"?(\d+)\"?\s*", preference)
        if found:
            seconds = min(float(found[1]), MAX_WAIT)
            response.headers["Preference-Applied"] = f"wait={seconds:g}"
            return Patience(request, seconds)
    return Patience(request, 0.0)


def _key(
    request: Request,
    idempotency_key: Annotated[str | None, Header(description="A repeated request with it is done once")] = None,
) -> str | None:
    if idempotency_key is None:
        return None
    if not re.fullmatch(r"[\x21-\x7e]{1,200}", idempotency_key):
        raise InvalidInput("Idempotency-Key", idempotency_key, "1 to 200 visible ASCII characters")
    return f"{request.url.path}:{idempotency_key}"


async def _body_hash(request: Request) -> str:
    return hashlib.sha256(await request.body()).hexdigest()


ServicesNeeded: TypeAlias = Annotated[Services, Depends(_services)]
Wait: TypeAlias = Annotated[Patience, Depends(_wait)]
"""How long the client is ready to wait; not at all when it did not say."""
IdempotencyKey: TypeAlias = Annotated[str | None, Depends(_key)]
BodyHash: TypeAlias = Annotated[str, Depends(_body_hash)]
Limit: TypeAlias = Annotated[int, Query(ge=1, le=1000, description="Most items of the answer")]
Before: TypeAlias = Annotated[int | None, Query(ge=0, description="Cursor of the Link header's next page")]


def link_next(response: Response, request: Request, limit: int, cursor: int | None) -> None:
    """Point to the next page."""
    if cursor is not None:
        response.headers["Link"] = f'<{request.url.path}?limit={limit}&before={cursor}>; rel="next"'
