"""Minimal HTTP/1.1 client with one keep-alive connection, cheap enough to load a service on the same machine."""

from __future__ import annotations

import asyncio
import json
import time
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

PATIENCE = 60.0
"""Seconds after which an answer is given up."""


@dataclass(frozen=True)
class Answer:
    """HTTP response: status (0 if the connection closed without a response), body, and duration in seconds."""

    status: int
    body: bytes
    seconds: float

    def json(self) -> Any:
        """Return the response body decoded from JSON."""
        return json.loads(self.body)


@dataclass
class Connection:
    """Persistent HTTP connection, opened on first use and reopened after the server has closed it."""

    url: str
    _reader: asyncio.StreamReader | None = field(default=None, repr=False)
    _writer: asyncio.StreamWriter | None = field(default=None, repr=False)

    async def request(self, path: str, body: bytes | None = None, method: str = "GET", **headers: str) -> Answer:
        """Send an HTTP request and return the whole response.

        A GET on a kept connection that ends without a word is sent again on a new one: the service may have ended it,
        as nothing was asked any more, while the request was on its way (RFC 9112, 9.3.1).
        """
        begun, was_kept, status = time.perf_counter(), self._reader is not None, 0
        try:
            async with asyncio.timeout(PATIENCE):
                reader, writer = await self._open()
                writer.write(format_head(self.url, path, method, body, **headers) + (body or b""))
                await writer.drain()
                status, fields = await parse_head(reader)
                content = await _read_body(reader, fields) if status not in {204, 304} else b""
        except (OSError, TimeoutError, asyncio.IncompleteReadError) as error:
            self.close()
            is_silent = isinstance(error, ConnectionError) or getattr(error, "partial", None) == b""
            if method == "GET" and was_kept and is_silent and not status:
                again = await self.request(path, body, method, **headers)
                return Answer(again.status, again.body, time.perf_counter() - begun)
            return Answer(0, b"", time.perf_counter() - begun)
        if fields.get("connection") == "close":
            self.close()
        return Answer(status, content, time.perf_counter() - begun)

    def close(self) -> None:
        """Close the connection."""
        if self._writer is not None:
            self._writer.close()
        self._reader = self._writer = None

    async def _open(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        if self._reader is None or self._writer is None or self._reader.at_eof():
            self.close()
            self._reader, self._writer = await connect(self.url)
        return self._reader, self._writer


async def connect(url: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Open a TCP connection to the host and port of a URL."""
    address = urlsplit(url)
    return await asyncio.open_connection(address.hostname, address.port)


def format_head(url: str, path: str, method: str = "GET", body: bytes | None = None, **headers: str) -> bytes:
    """Return the head of an HTTP request as bytes; ``Idempotency_Key`` is the header Idempotency-Key."""
    lines = [f"{method} {path} HTTP/1.1", f"Host: {urlsplit(url).netloc}"]
    if body is not None:
        lines += ["Content-Type: application/json", f"Content-Length: {len(body)}"]
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    return ("\r\n".join(lines) + "\r\n\r\n").encode()


async def parse_head(reader: asyncio.StreamReader) -> tuple[int, dict[str, str]]:
    """Read the status and headers of an HTTP response; header names in lower case."""
    lines = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
    pairs = (line.partition(":") for line in lines[1:] if line)
    return int(lines[0].split(" ", 2)[1]), {name.lower(): value.strip() for name, _, value in pairs}


async def _read_body(reader: asyncio.StreamReader, fields: dict[str, str]) -> bytes:
    if fields.get("transfer-encoding") != "chunked":
        return await reader.readexactly(int(fields.get("content-length", "0")))
    parts = []
    while size := int(await reader.readuntil(b"\r\n"), 16):
        parts.append((await reader.readexactly(size + 2))[:-2])
    await reader.readexactly(2)
    return b"".join(parts)
