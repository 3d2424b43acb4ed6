"""Load test of the service: many clients during a scan and a job, fast readers, and misbehaving clients."""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from steradian.benchmarks.http_client import Connection
from steradian.benchmarks.misbehaving_clients import measure_under_abuse
from steradian.benchmarks.mixed_load import SAMPLES, V1, mixed, spread
from steradian.benchmarks.service import RunningService, make_scan, running_service, wait_for_reconstruction
from steradian.core.progress import Progress
from steradian.core.settings import Settings

Row = dict[str, Any]
READERS = 32


def load(
    *, seconds: float = 60.0, clients: int = 150, streams: int = 50, progress: Progress | None = None
) -> list[Row]:
    """Run the load test of a service in its own data folder, with the simulated scanner in real time.

    Parameters
    ----------
    seconds
        For how long the mixed clients ask; the fast readers get a twelfth of it a route, at most 5 s.
    clients, streams
        Mixed clients and event streams.

    Returns
    -------
    list of dict
        Rows of five kinds, told apart by ``case``: *route* (times of each), *total*, *memory* (of each kind of process,
        over the time of the mixed clients, with its growth a minute), *reads* (a second, over 32 kept connections) and
        *rude* (the worst answer of /healthz while clients behave badly).
    """
    with tempfile.TemporaryDirectory(prefix="steradian-benchmark-") as folder:
        settings = Settings.create(data=Path(folder), port=0, workers=1, simulator_speed=1.0)
        with running_service(settings) as service:
            things = create_fixtures(service)
            return asyncio.run(_measure(service, things, seconds, clients, streams, progress))


def create_fixtures(service: RunningService) -> dict[str, Any]:
    """Create the resources that the clients read: 30 masks and plans, a scan, 12 reconstructions."""
    equi = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3}
    masks = [service.request("/masks", equi | {"count": 100 + number})["id"] for number in range(30)]
    plans = [service.request("/plans", {"mask_id": mask, "samples": SAMPLES})["id"] for mask in masks]
    scan = make_scan(service, count=200, samples=SAMPLES)
    body = {"scan_id": scan, "parameters": {"modes": 64}}
    jobs = [service.request("/reconstructions", body)["id"] for _ in range(12)]
    for job in jobs:
        wait_for_reconstruction(service, job)
    return {"masks": masks, "plans": plans, "scan": scan, "jobs": jobs}


async def _measure(
    service: RunningService,
    things: dict[str, Any],
    seconds: float,
    clients: int,
    streams: int,
    progress: Progress | None,
) -> list[Row]:
    stages = ["clients", "readers", "rude clients"]

    def at(stage: str) -> None:
        if progress is not None:
            progress(stage, stages.index(stage), len(stages))

    at("clients")
    rows = await mixed([service], things, seconds, clients, streams)
    at("readers")
    rows += await _fast_readers(service, things, min(5.0, max(1.0, seconds / 12)))
    at("rude clients")
    return rows + await measure_under_abuse(service)


async def _fast_readers(service: RunningService, things: dict[str, Any], seconds: float) -> list[Row]:
    """Measure the read rate of each route on 32 keep-alive connections, against that of /healthz."""
    one = {name: [f"{V1}/{name}"] for name in ("masks", "plans", "scans", "reconstructions", "jobs")}
    routes = {
        "one mask": [f"{V1}/masks/{things['masks'][0]}"],
        "30 masks in turn": [f"{V1}/masks/{mask}" for mask in things["masks"]],
        **one,
        "one job": [f"{V1}/jobs/{things['jobs'][0]}"],
        "12 jobs in turn": [f"{V1}/jobs/{job}" for job in things["jobs"]],
        "one scan": [f"{V1}/scans/{things['scan']}"],
    }
    rows, health = [], await _rate(service.url, ["/healthz"], seconds)
    for name, paths in routes.items():
        found, again = await _rate(service.url, paths, seconds), await _rate(service.url, ["/healthz"], seconds / 2)
        beside = (health["rate"] + again["rate"]) / 2
        figures = {"reads_per_second": found["rate"], "healthz_per_second": beside, "ratio": found["rate"] / beside}
        rows.append({"case": "reads", "route": name, **figures} | spread(found["times"]))
        health = again
    return rows


async def _rate(url: str, paths: Sequence[str], seconds: float) -> dict[str, Any]:
    """Read continuously on :data:`READERS` keep-alive connections; return reads per second and each read's duration."""
    times: list[float] = []
    end = time.perf_counter() + seconds

    async def read(number: int) -> None:
        connection = Connection(url)
        while time.perf_counter() < end:
            answer = await connection.request(paths[number % len(paths)])
            if answer.status != 200:
                raise RuntimeError(f"{paths[number % len(paths)]} answered {answer.status}")
            times.append(answer.seconds)
            number += READERS
        connection.close()

    begun = time.perf_counter()
    await asyncio.gather(*(read(number) for number in range(READERS)))
    return {"rate": len(times) / (time.perf_counter() - begun), "times": times}
