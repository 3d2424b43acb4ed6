"""HTTP transports over a blocking or an asynchronous httpx client, and their request objects."""

from __future__ import annotations

import hashlib
import time
from abc import ABC, abstractmethod
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Iterator, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeVar

import anyio
import httpx

T = TypeVar("T")
PIECE: Final = 2**18
"""Bytes of a file that are read, sent and counted at a time."""


class UploadFile:
    """File being sent, with the checksum of the bytes sent so far.

    Parameters
    ----------
    path
        The file.
    report
        Told how many bytes of how many have left.

    Attributes
    ----------
    start
        Bytes of it that are there already; it goes on behind them.
    """

    def __init__(self, path: Path, report: Callable[[int, int], None] | None = None) -> None:
        self.path, self._report = path, report
        self.size, self.sha256, self.start = path.stat().st_size, "", 0

    def pieces(self) -> Iterator[bytes]:
        """Yield the content after the offset in chunks; each call reads the file from its beginning."""
        digest, done = hashlib.sha256(), 0
        with self.path.open("rb") as source:
            while piece := source.read(PIECE):
                digest.update(piece)
                done += len(piece)
                if done <= self.start:
                    continue
                if self._report is not None:
                    self._report(done, self.size)
                yield piece[max(0, self.start - (done - len(piece))) :]
        self.sha256 = digest.hexdigest()


@dataclass(frozen=True)
class Request:
    """HTTP request: method, path, parameters, headers and body.

    Attributes
    ----------
    json, file
        The body: a document, or a file's bytes as they lie there.
    timeout
        Longest silence (s); ``None``: as the transport has it.
    """

    method: str
    path: str
    params: Mapping[str, Any] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    json: Any = None
    file: UploadFile | None = None
    timeout: float | None = None


@dataclass(frozen=True)
class StreamedResponse:
    """HTTP response with a body that is read as a stream."""

    response: httpx.Response
    pieces: AsyncIterator[bytes]

    async def read(self) -> httpx.Response:
        """Read and return the whole body, for example that of an error."""
        content = b"".join([piece async for piece in self.pieces])
        about = self.response
        return httpx.Response(about.status_code, headers=about.headers, content=content, request=about.request)


class Transport(ABC):
    """Base class of HTTP transports, which send requests to one service.

    Parameters
    ----------
    url
        Address of the service, for example ``http://127.0.0.1:8000``.
    key
        API key, which a service on another machine asks for.
    timeout
        Longest silence (s).
    """

    blocks: bool

    def __init__(self, url: str, key: str | None, timeout: float) -> None:
        self.url, self.timeout = url.rstrip("/"), timeout
        self.headers = {"User-Agent": "steradian-client"} | ({"Authorization": f"Bearer {key}"} if key else {})

    @abstractmethod
    async def send(self, request: Request) -> httpx.Response:
        """Send a request and return the response with its whole body; raises :class:`httpx.TransportError`."""

    @abstractmethod
    def stream(self, request: Request) -> AbstractAsyncContextManager[StreamedResponse]:
        """Send a request and yield the response before its body is read; raises :class:`httpx.TransportError`."""

    @abstractmethod
    async def sleep(self, seconds: float) -> None:
        """Wait for ``seconds``."""

    @abstractmethod
    async def call(self, function: Callable[[], T]) -> T:
        """Run a slow function, for example reading a file, without blocking other tasks."""

    @abstractmethod
    async def close(self) -> None:
        """Close all connections to the service."""

    def _options(self, request: Request) -> dict[str, Any]:
        size = {} if request.file is None else {"Content-Length": str(request.file.size - request.file.start)}
        return {
            "method": request.method,
            "url": request.path,
            "params": {name: _texts(value) for name, value in request.params.items() if value is not None},
            "headers": {**request.headers, **size},
            "json": request.json,
            "timeout": httpx.Timeout(request.timeout or self.timeout, connect=min(self.timeout, 10.0)),
        }


class SyncTransport(Transport):
    """Blocking HTTP transport with coroutines that never suspend."""

    blocks = True

    def __init__(self, url: str, key: str | None, timeout: float) -> None:
        super().__init__(url, key, timeout)
        self._http = httpx.Client(base_url=self.url, headers=self.headers)

    async def send(self, request: Request) -> httpx.Response:
        """Send a request and return the response with its whole body."""
        content = None if request.file is None else request.file.pieces()
        return self._http.request(content=content, **self._options(request))

    @asynccontextmanager
    async def stream(self, request: Request) -> AsyncGenerator[StreamedResponse, None]:
        """Send a request and yield the response before its body is read."""
        with self._http.stream(**self._options(request)) as response:

            async def pieces() -> AsyncGenerator[bytes, None]:
                for piece in response.iter_bytes():
                    yield piece

            yield StreamedResponse(response, pieces())

    async def sleep(self, seconds: float) -> None:
        """Block for ``seconds``."""
        time.sleep(seconds)  # noqa: ASYNC251 - there is no loop that it could hold up

    async def call(self, function: Callable[[], T]) -> T:
        """Call a function in the caller's thread."""
        return function()

    async def close(self) -> None:
        """Close all connections to the service."""
        self._http.close()


class AsyncTransport(Transport):
    """Asynchronous HTTP transport, under asyncio or trio."""

    blocks = False

    def __init__(self, url: str, key: str | None, timeout: float) -> None:
        super().__init__(url, key, timeout)
        self._http = httpx.AsyncClient(base_url=self.url, headers=self.headers)

    async def send(self, request: Request) -> httpx.Response:
        """Send a request and return the response with its whole body."""
        content = None if request.file is None else self._pieces(request.file.pieces())
        return await self._http.request(content=content, **self._options(request))

    @asynccontextmanager
    async def stream(self, request: Request) -> AsyncGenerator[StreamedResponse, None]:
        """Send a request and yield the response before its body is read."""
        async with self._http.stream(**self._options(request)) as response:
            yield StreamedResponse(response, response.aiter_bytes())

    async def sleep(self, seconds: float) -> None:
        """Wait for ``seconds`` without blocking other tasks."""
        await anyio.sleep(seconds)

    async def call(self, function: Callable[[], T]) -> T:
        """Call a function in a worker thread."""
        return await anyio.to_thread.run_sync(function)

    async def close(self) -> None:
        """Close all connections to the service."""
        await self._http.aclose()

    async def _pieces(self, source: Iterator[bytes]) -> AsyncGenerator[bytes, None]:
        while piece := await self.call(lambda: next(source, b"")):
            yield piece


def _texts(value: Any) -> str | list[str]:
    if isinstance(value, list | tuple):
        return [str(one) for one in value]
    return str(value).lower() if isinstance(value, bool) else str(value)
