"""HTTP session: requests with retries where safe, responses as models or exceptions."""

from __future__ import annotations

import time
import uuid
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from typing import Any, Final, TypeVar

import httpx

from steradian_client.errors import ConnectionFailed, ServiceError
from steradian_client.models import ResponseModel
from steradian_client.routes import Route
from steradian_client.transport import Request, StreamedResponse, Transport, UploadFile

Kind = TypeVar("Kind", bound=ResponseModel)
RETRY_TIMEOUT: Final = 60.0
"""Seconds for which a service that has answered before is tried again, long enough for it to be started anew."""
INITIAL_BACKOFF, LONGEST_PAUSE = 0.2, 5.0
RETRYABLE: Final = frozenset({429, 502, 503, 504})
"""Statuses that pass by themselves."""
PAGE: Final = 1000


class RequestSession:
    """Session shared by a client's resource collections: requests with retries, responses as models or exceptions.

    Parameters
    ----------
    transport
        Sends requests.
    patience
        Seconds for which requests are sent again while the service is away.
    """

    def __init__(self, transport: Transport, patience: float = RETRY_TIMEOUT) -> None:
        self.transport, self.patience = transport, patience
        self.has_answered = False
        """Whether anything was ever heard from that address; a wrong one is not worth patience."""

    async def send_with_retries(
        self,
        route: Route,
        identifiers: Mapping[str, str] | None = None,
        *,
        params: Mapping[str, Any] | None = None,
        json: Any = None,
        file: UploadFile | None = None,
        headers: Mapping[str, str] | None = None,
        key: str | None = None,
        wait: float = 0.0,
        accepted: frozenset[int] = frozenset(),
    ) -> httpx.Response:
        """Send a request, retrying where repetition is safe, and return the response.

        Parameters
        ----------
        key
            Idempotency key of a route that takes one; ``None`` makes a new one for all attempts.
        wait
            Seconds for which the service may hold the answer until work is over.
        accepted
            Statuses that are an answer although they are errors.

        Raises
        ------
        ServiceError, Unreachable
            When the service refuses, or none answers.
        """
        own = {"Idempotency-Key": key or str(uuid.uuid4())} if route.keyed else {}
        own |= {"Prefer": f"wait={wait:.0f}"} if wait >= 1 else {}
        path, timeout = route.path(**identifiers or {}), self.transport.timeout + wait
        request = Request(route.method, path, params or {}, {**own, **(headers or {})}, json, file, timeout)
        begun, pause, was_lost = time.monotonic(), INITIAL_BACKOFF, False
        while True:
            failure: Exception
            try:
                answer = await self.transport.send(request)
                self.has_answered = True
                if answer.is_success or answer.status_code in accepted:
                    return answer
                if answer.status_code == 404 and was_lost and route.method == "DELETE":
                    return answer  # the lost answer said that it is done
                failure = problem_of(answer)
                again = answer.status_code in RETRYABLE and route.repeatable
                pause = max(pause, _retry_after(answer))
            except httpx.TransportError as error:
                never_left = isinstance(error, httpx.ConnectError | httpx.ConnectTimeout)
                failure, again = self.unreachable(error, route), route.repeatable and self.has_answered
                was_lost = was_lost or not never_left
            if not again or time.monotonic() + pause - begun > self.patience:
                raise failure
            await self.transport.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE)

    async def request_model(
        self, kind: type[Kind], route: Route, identifiers: Mapping[str, str] | None = None, **more: Any
    ) -> Kind:
        """Send a request and return its response as a model; ``more`` and errors as of :meth:`send_with_retries`."""
        return kind.model_validate_json((await self.send_with_retries(route, identifiers, **more)).content)

    async def list(
        self,
        kind: type[Kind],
        route: Route,
        limit: int | None = None,
        filters: Mapping[str, Any] | None = None,
        identifiers: Mapping[str, str] | None = None,
    ) -> list[Kind]:
        """Return the newest ``limit`` resources, read page by page; errors as of :meth:`send_with_retries`."""
        found: list[Kind] = []
        params: Mapping[str, Any] | None = filters or {}
        if limit is not None:
            params = {**(filters or {}), "limit": min(limit, PAGE)}
        while params is not None and (limit is None or len(found) < limit):
            answer = await self.send_with_retries(route, identifiers, params=params)
            found += [kind.model_validate(item) for item in answer.json()["items"]]
            following = answer.links.get("next", {}).get("url")
            named = httpx.URL(following).params if following else None
            params = named and {name: named.get_list(name) for name in named}
        return found[:limit]

    @asynccontextmanager
    async def open(
        self, route: Route, identifiers: Mapping[str, str], **more: Any
    ) -> AsyncGenerator[StreamedResponse, None]:
        """Send a request once and yield the response, whose body the caller reads as a stream.

        Raises
        ------
        ServiceError, Unreachable
            When the service refuses, none answers, or the connection breaks off while the answer comes.
        """
        try:
            async with self.transport.stream(Request(route.method, route.path(**identifiers), **more)) as incoming:
                self.has_answered = True
                if incoming.response.is_error:
                    raise problem_of(await incoming.read())
                yield incoming
        except httpx.TransportError as error:
            raise self.unreachable(error, route) from error

    def unreachable(self, error: httpx.TransportError, route: Route) -> ConnectionFailed:
        """Return the error for a request without response, with whether the service may have processed it."""
        said = f"no answer from {self.transport.url}: {str(error) or type(error).__name__}"
        if not route.repeatable and not isinstance(error, httpx.ConnectError | httpx.ConnectTimeout):
            said += f"; {route.method} {route.template} may have been done all the same, so look before you repeat it"
        return ConnectionFailed(said)


def problem_of(answer: httpx.Response) -> ServiceError:
    """Return the exception for an error response."""
    try:
        problem = answer.json()
    except ValueError:
        problem = _not_ours(answer)
    return ServiceError.of(answer.status_code, problem if isinstance(problem, dict) else {"detail": str(problem)})


def _not_ours(answer: httpx.Response) -> dict[str, Any]:
    """Return a problem for an error response that a proxy sent, without a problem document."""
    if answer.status_code != 413:
        return {"title": answer.reason_phrase}
    server = answer.headers.get("Server", "")
    who = f"a proxy in front of the service ({server})" if server else "a proxy in front of the service"
    settings = "client_max_body_size in nginx, request_body max_size in Caddy, LimitRequestBody in Apache"
    detail = f"{who} rejected the body as too large before it reached the service; its limit is {settings}"
    return {"code": "proxy-refused-size", "detail": detail}


def _retry_after(answer: httpx.Response) -> float:
    text = answer.headers.get("Retry-After", "")
    return float(text) if text.isdecimal() else 0.0
