"""Mixed workload of many HTTP clients during a scan and jobs."""

from __future__ import annotations

import asyncio
import json
import random
import statistics
import time
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from itertools import cycle
from typing import Any

from steradian.benchmarks.event_listeners import compare, open_listeners
from steradian.benchmarks.http_client import Connection
from steradian.benchmarks.service import RunningService, api_process, processor_seconds, wait_for_reconstruction
from steradian.benchmarks.service_memory import MemorySampler

Row = dict[str, Any]
V1 = "/api/v1"
THINK_TIME = 0.5
"""Mean pause of a client between two requests (s)."""
PULSE_RATE, POINTS, SAMPLES = 1000, 1605, 256
POLLS = 120
"""How often memory is looked at, at most once a second."""
SEED = 1
LIGHT_REQUESTS = frozenset({"masks", "plans", "scans", "reconstructions", "jobs", "mask", "scan", "job", "coverage"})
"""Routes that people look at all the time; the others work something out or read files."""
WEIGHTS = {
    "masks": 5, "plans": 5, "scans": 8, "reconstructions": 8, "jobs": 8, "mask": 5, "scan": 14, "job": 14,
    "coverage": 10, "preview": 7, "picture": 4, "mip": 4, "volume": 4, "alines": 4,
}  # fmt: skip
"""How often each route is asked, of 100 requests."""


async def mixed(
    services: Sequence[RunningService], things: dict[str, Any], seconds: float, clients: int, streams: int
) -> list[Row]:
    """Measure response times of HTTP clients and event streams during a scan and consecutive jobs.

    Parameters
    ----------
    services
        Whom they ask in turn: one service, or nodes of one.
    things
        What there is to read, by the name of its kind.
    seconds, clients, streams
        For how long, and how many of both.
    """
    service = services[0]

    def api_seconds() -> float:
        return sum(processor_seconds(api_process(each.pid), children=False) for each in services)

    used, own = api_seconds(), time.process_time()
    scan, wanted = await asyncio.to_thread(_long_scan, service, seconds)
    over = asyncio.Event()
    times: dict[str, list[float]] = defaultdict(list)
    statuses: dict[int, int] = defaultdict(int)
    asked = cycle(services)
    memories = [MemorySampler(each.pid, max(1.0, seconds / POLLS)) for each in services]
    async with open_listeners([each.url for each in services], streams) as listeners:
        watching = [asyncio.create_task(memory.watch(over)) for memory in memories]
        working = asyncio.create_task(_jobs(service, things["scan"], over))
        asking = [
            asyncio.create_task(_ask(next(asked), things, scan, over, random.Random(SEED + number), times, statuses))  # noqa: S311
            for number in range(clients)
        ]
        begun = time.monotonic()
        await asyncio.sleep(seconds)
        over.set()
        await asyncio.gather(*asking, *watching)
        took = time.monotonic() - begun
        used, own = api_seconds() - used, time.process_time() - own
        jobs = await working
        view = await asyncio.to_thread(_settled, service, scan)
        told = await compare(listeners)
    answered = sum(len(found) for found in times.values())
    light = [value for name in LIGHT_REQUESTS for value in times[name]]
    return [
        *({"case": "route", "route": name, "light": name in LIGHT_REQUESTS} | spread(times[name]) for name in WEIGHTS),
        {"case": "route", "route": "all light reads", "light": True} | spread(light),
        {
            "case": "total",
            "clients": clients,
            "streams": streams,
            "seconds": took,
            "requests_per_second": answered / took,
            "api_cpu_ms_per_request": 1e3 * used / max(1, answered),
            "clients_cpu_ms_per_request": 1e3 * own / max(1, answered),
            "server_errors": sum(count for status, count in statuses.items() if status >= 500 or not status),
            "statuses": {str(status): count for status, count in sorted(statuses.items())},
            "events": told.events,
            "events_lost": told.lost,
            "events_again": told.again,
            "jobs_succeeded": jobs,
            "alines": wanted,
            "alines_lost": wanted - view["summary"]["stored"],
            "scan": view["state"],
        },
        *(row for memory in memories for row in memory.rows()),
    ]


def _long_scan(service: RunningService, seconds: float) -> tuple[str, int]:
    """Start a scan at 1 kHz that lasts about as long as the load; return its identifier and number of A-lines."""
    equi = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": POINTS}
    mask = service.request("/masks", equi)
    frames = max(1, round(seconds * PULSE_RATE / mask["count"]))
    body = {"mask_id": mask["id"], "samples": SAMPLES, "pulse_rate": PULSE_RATE, "frames": frames}
    plan = service.request("/plans", body)
    scan = service.request("/scans", {"plan_id": plan["id"]}, **{"Idempotency-Key": f"load-{time.time_ns()}"})
    while not service.request(f"/scans/{scan['id']}")["progress"]["done"]:
        time.sleep(0.1)
    return str(scan["id"]), mask["count"] * frames


def _settled(service: RunningService, scan: str) -> dict[str, Any]:
    while (view := service.request(f"/scans/{scan}", Prefer="wait=60"))["state"] not in {
        "complete",
        "partial",
        "failed",
    }:
        pass
    found: dict[str, Any] = view
    return found


async def _ask(
    service: RunningService,
    things: dict[str, Any],
    scan: str,
    over: asyncio.Event,
    chance: random.Random,
    times: dict[str, list[float]],
    statuses: dict[int, int],
) -> None:
    """Run one HTTP client that alternates between requests and pauses."""
    connection = Connection(service.url)
    while not over.is_set():
        with suppress(TimeoutError):
            await asyncio.wait_for(over.wait(), chance.expovariate(1 / THINK_TIME))
            return connection.close()
        name = chance.choices(list(WEIGHTS), list(WEIGHTS.values()))[0]
        path, body = _request(name, things, scan, chance)
        answer = await connection.request(V1 + path, body, "GET" if body is None else "POST")
        times[name].append(answer.seconds)
        statuses[answer.status] += 1
    return connection.close()


def _request(name: str, things: dict[str, Any], scan: str, chance: random.Random) -> tuple[str, bytes | None]:
    """Return path and body of a random request of one kind."""
    job, mask = chance.choice(things["jobs"]), chance.choice(things["masks"])
    paths = {
        "mask": f"/masks/{mask}",
        "scan": f"/scans/{scan}",
        "job": f"/jobs/{job}",
        "coverage": f"/scans/{scan}/coverage",
        "preview": "/plans/preview",
        "picture": f"/masks/{mask}/picture",
        "mip": f"/reconstructions/{job}/mip?axis={chance.choice('xyz')}",
        "volume": f"/reconstructions/{job}/volume?slice=:,:,{chance.randrange(SAMPLES)}",
        "alines": f"/scans/{scan}/alines?slice={chance.randrange(100)},:",
    }
    body = json.dumps({"mask_id": mask, "pulse_rate": chance.randint(10, 500)}).encode() if name == "preview" else None
    return paths.get(name, f"/{name}"), body


async def _jobs(service: RunningService, scan: str, over: asyncio.Event) -> int:
    """Run reconstructions one after the other; return the number of successes."""
    done, body = 0, {"scan_id": scan, "parameters": {"modes": 226}}
    while not over.is_set():
        job = await asyncio.to_thread(service.request, "/reconstructions", body)
        await asyncio.to_thread(wait_for_reconstruction, service, job["id"])
        done += 1
    return done


def spread(seconds: Sequence[float]) -> Row:
    """Return count, median, 99th percentile and maximum of durations in milliseconds."""
    if len(seconds) < 2:
        return {"requests": len(seconds)}
    return {
        "requests": len(seconds),
        "p50_ms": 1e3 * statistics.median(seconds),
        "p99_ms": 1e3 * statistics.quantiles(seconds, n=100, method="inclusive")[98],
        "worst_ms": 1e3 * max(seconds),
    }
