"""Abusive HTTP clients for the load test: slow headers, slow bodies, many event streams.

Each deed has a process of its own, as what it costs its doer must not count as the service's delay.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections import Counter
from collections.abc import Callable, Coroutine
from typing import Any

from steradian.benchmarks.http_client import Connection, connect, format_head, parse_head

V1 = "/api/v1"
SLOW = 300
STREAMS = 1000
BODY_MIB = 60
AbusePattern = Callable[[str, float], Coroutine[Any, Any, dict[str, int]]]


async def _baseline(_url: str, patience: float) -> dict[str, int]:
    await asyncio.sleep(patience)
    return {}


async def _half_headers(url: str, patience: float) -> dict[str, int]:
    return await _hold_connections(url, f"GET {V1}/masks HTTP/1.1\r\nHost: half\r\nX-More: ".encode(), patience)


async def _half_bodies(url: str, patience: float) -> dict[str, int]:
    begun = format_head(url, f"{V1}/masks", "POST", bytes(100_000)) + b'{"arrangement": '
    return await _hold_connections(url, begun, patience)


async def _hold_connections(url: str, begun: bytes, patience: float) -> dict[str, int]:
    """Send incomplete requests on many connections and wait; return the number closed by the service."""
    held = [await connect(url) for _ in range(SLOW)]
    for _, writer in held:
        writer.write(begun)
    await asyncio.sleep(patience)
    closed = 0
    for reader, writer in held:
        try:
            async with asyncio.timeout(0.01):
                closed += await reader.read() is not None
        except ConnectionError:
            closed += 1
        except TimeoutError:
            pass
        writer.close()
    return {"closed": closed, "kept": SLOW - closed}


async def _streams(url: str, _patience: float) -> dict[str, int]:
    """Open many event streams at once; return the number of responses by status."""

    async def ask() -> tuple[int, asyncio.StreamWriter | None]:
        try:
            async with asyncio.timeout(30):
                reader, writer = await connect(url)
                writer.write(format_head(url, f"{V1}/events"))
                return (await parse_head(reader))[0], writer
        except (OSError, TimeoutError, asyncio.IncompleteReadError):
            return 0, None

    found = await asyncio.gather(*(ask() for _ in range(STREAMS)))
    for _, writer in found:
        if writer is not None:
            writer.close()
    return {str(status): count for status, count in Counter(status for status, _ in found).items()}


async def _many_positions(url: str, _patience: float) -> dict[str, int]:
    pair = b"[0.001234567890123, -0.004567890123456], "
    positions = pair * (BODY_MIB * 2**20 // len(pair) - 100)
    body = b'{"arrangement": "points", "aperture": 0.01, "positions": [' + positions + b"[0, 0]]}"
    return await _send(url, f"{V1}/masks", body)


async def _large_body(url: str, _patience: float) -> dict[str, int]:
    body = b'{"reason": "' + b"x" * (BODY_MIB * 2**20 - 100) + b'"}'
    return await _send(url, f"{V1}/jobs", body)


async def _send(url: str, path: str, body: bytes) -> dict[str, int]:
    """Send a request body on two connections, one after the other; return the statuses."""
    found: Counter[int] = Counter()
    for _ in range(2):
        connection = Connection(url)
        found[(await connection.request(path, body, "POST")).status] += 1
        connection.close()
    return {str(status): count for status, count in found.items()}


ABUSE_PATTERNS: dict[str, AbusePattern] = {
    "nobody": _baseline,
    f"{SLOW} half-sent headers": _half_headers,
    f"{SLOW} half-sent bodies": _half_bodies,
    f"{STREAMS} streams at once": _streams,
    f"{BODY_MIB} MiB of positions": _many_positions,
    f"{BODY_MIB} MiB where a few bytes belong": _large_body,
}
"""What they are called in tables; each returns how often it met with what."""


def main(name: str, url: str, patience: str) -> None:
    """Run one abuse pattern and print the counts of responses as JSON."""
    print(json.dumps(asyncio.run(ABUSE_PATTERNS[name](url, float(patience)))))


if __name__ == "__main__":
    main(*sys.argv[1:])
