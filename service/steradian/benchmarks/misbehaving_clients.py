"""Measurement of the latency of /healthz while clients misbehave."""

from __future__ import annotations

import asyncio
import json
import sys
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from steradian.benchmarks.abuse_patterns import ABUSE_PATTERNS
from steradian.benchmarks.http_client import Connection
from steradian.benchmarks.service import RunningService, api_process, memory_mib
from steradian.core.exceptions import SteradianError

LIMIT_MS = 200.0
"""What /healthz must not take, whatever others do."""
LOOK = 0.02
BEYOND = 5.0
"""Seconds for which slow clients stay after the service should have given them up."""


async def measure_under_abuse(service: RunningService) -> list[dict[str, Any]]:
    """Measure the slowest response of /healthz, each on a new connection, while clients misbehave.

    What they do, they do in another process; slow ones stay until the service should have given them up, and longer.
    """
    pid, rows = api_process(service.pid), []
    for name in ABUSE_PATTERNS:
        before = memory_mib(pid)
        times: list[float] = []
        async with _probe_health(service.url, times):
            found = await _run_abuse(name, service.url, service.settings.client_timeout + BEYOND)
            await asyncio.sleep(1.0)
        figures = {"healthz_worst_ms": 1e3 * max(times), "limit_ms": LIMIT_MS, "looks": len(times)}
        memory = {"memory_before_mib": before, "memory_after_mib": memory_mib(pid)}
        rows.append({"case": "rude", "clients": name, **figures, **memory, "met_with": found})
    return rows


async def _run_abuse(name: str, url: str, patience: float) -> dict[str, int]:
    """Run an abuse pattern in a separate process; return the counts of its responses."""
    command = (sys.executable, "-P", "-m", "steradian.benchmarks.abuse_patterns", name, url, str(patience))
    process = await asyncio.create_subprocess_exec(*command, stdout=PIPE)
    said, _ = await process.communicate()
    if process.returncode:
        raise SteradianError(f"the clients of {name!r} failed")
    found: dict[str, int] = json.loads(said)
    return found


@asynccontextmanager
async def _probe_health(url: str, times: list[float]) -> AsyncIterator[None]:
    """Poll /healthz until the block ends; a failed request counts as 60 seconds."""
    over = asyncio.Event()

    async def look() -> None:
        while not over.is_set():
            connection = Connection(url)
            answer = await connection.request("/healthz")
            times.append(answer.seconds if answer.status == 200 else 60.0)
            connection.close()
            await asyncio.sleep(LOOK)

    task = asyncio.create_task(look())
    try:
        yield
    finally:
        over.set()
        await task
