"""Clients that behave badly, and how long /healthz takes beside them."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from steradian.benchmarks.http_client import Connection, connect, head, read_head
from steradian.benchmarks.service import RunningService, api_process, memory_mib

V1 = "/api/v1"
LIMIT_MS = 200.0
"""What /healthz must not take, whatever others do."""
LOOK = 0.02
SLOW = 300
STREAMS = 1000
BODY_MIB = 60
Deed = Callable[[str, float], Coroutine[Any, Any, dict[str, int]]]


async def rude_clients(service: RunningService, *, patience: float) -> list[dict[str, Any]]:
    """Measure the worst answer of /healthz, each on a connection of its own, while clients behave badly.

    Parameters
    ----------
    patience
        Seconds for which slow clients stay.
    """
    deeds: dict[str, Deed] = {
        "nobody": _nobody,
        f"{SLOW} half-sent headers": _half_headers,
        f"{SLOW} half-sent bodies": _half_bodies,
        f"{STREAMS} streams at once": _streams,
        f"{BODY_MIB} MiB of positions": _many_positions,
        f"{BODY_MIB} MiB where a few bytes belong": _large_body,
    }
    pid, rows = api_process(service.pid), []
    for name, deed in deeds.items():
        before = memory_mib(pid)
        times: list[float] = []
        async with _watching(service.url, times):
            found = await deed(service.url, patience)
            await asyncio.sleep(1.0)
        figures = {"healthz_worst_ms": 1e3 * max(times), "limit_ms": LIMIT_MS, "looks": len(times)}
        memory = {"memory_before_mib": before, "memory_after_mib": memory_mib(pid)}
        rows.append({"case": "rude", "clients": name, **figures, **memory, "met_with": found})
    return rows


@asynccontextmanager
async def _watching(url: str, times: list[float]) -> AsyncIterator[None]:
    """Ask /healthz again and again until the block ends; an answer that fails counts as a minute."""
    over = asyncio.Event()

    async def look() -> None:
        while not over.is_set():
            connection = Connection(url)
            answer = await connection.ask("/healthz")
            times.append(answer.seconds if answer.status == 200 else 60.0)
            connection.close()
            await asyncio.sleep(LOOK)

    task = asyncio.create_task(look())
    try:
        yield
    finally:
        over.set()
        await task


async def _nobody(_url: str, patience: float) -> dict[str, int]:
    await asyncio.sleep(patience)
    return {}


async def _half_headers(url: str, patience: float) -> dict[str, int]:
    return await _stay(url, f"GET {V1}/masks HTTP/1.1\r\nHost: half\r\nX-More: ".encode(), patience)


async def _half_bodies(url: str, patience: float) -> dict[str, int]:
    begun = head(url, f"{V1}/masks", "POST", bytes(100_000)) + b'{"arrangement": '
    return await _stay(url, begun, patience)


async def _stay(url: str, begun: bytes, patience: float) -> dict[str, int]:
    """Send the beginning of a request on many connections and wait; tells how many the service has closed."""
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
    """Ask for many event streams in the same moment; tells how many were answered with each status."""

    async def ask() -> tuple[int, asyncio.StreamWriter | None]:
        try:
            async with asyncio.timeout(30):
                reader, writer = await connect(url)
                writer.write(head(url, f"{V1}/events"))
                return (await read_head(reader))[0], writer
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
    """Send a body, on two connections one after the other; tells the statuses."""
    found: Counter[int] = Counter()
    for _ in range(2):
        connection = Connection(url)
        found[(await connection.ask(path, body, "POST")).status] += 1
        connection.close()
    return {str(status): count for status, count in found.items()}
