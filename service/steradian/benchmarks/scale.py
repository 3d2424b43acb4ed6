"""Benchmark of a service of several nodes against a service on one machine.

Many clients, one and three workers, cost of the store.
"""

from __future__ import annotations

import asyncio
import os
import secrets
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from statistics import fmean
from typing import Any

from steradian.benchmarks.load import create_fixtures
from steradian.benchmarks.mixed_load import mixed
from steradian.benchmarks.queueing_model import JOBS, load_of_scanners, measure_poisson_arrivals
from steradian.benchmarks.service import (
    RunningService,
    busy_seconds,
    make_scan,
    processor_seconds,
    running_service,
    running_worker,
)
from steradian.benchmarks.service_overhead import run_through_service
from steradian.core.progress import Progress
from steradian.core.settings import Settings
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.repositories.event_log import EventLog, append_event

SINGLE_SERVICE, MULTI_NODE = "one service", "two API nodes"
WORKERS = 3
WARMUP_JOBS = 2
"""Jobs of each worker before those that are timed: it then has its kernels and the scan."""
POINTS, SAMPLES, MODES = 1605, 1024, 226
"""Of the jobs that are timed: the paper's yarn."""
EVENTS = 200
"""Written one after the other, to see how long one holds the lock that puts them in order."""
Row = dict[str, Any]


def scale(
    shared: dict[str, Any],
    *,
    seconds: float = 60.0,
    clients: int = 200,
    streams: int = 20,
    jobs: int = 20,
    progress: Progress | None = None,
) -> list[Row]:
    """Measure a single-machine service, then several nodes with shared database and object store.

    Parameters
    ----------
    shared
        What the nodes share: ``database_url`` of an empty PostgreSQL database, ``store``, ``store_endpoint``.
    seconds, clients, streams
        For how long mixed clients ask and event streams listen, and how many; see
        :mod:`steradian.benchmarks.mixed_load`.
    jobs
        Reconstructions that each number of workers makes; twice as many come by chance.

    Returns
    -------
    list of dict
        Rows of *route*, *total* and *memory*, as of the load, and of *jobs*: ``jobs_per_second``, ``cpu_s_per_job`` (of
        the service's own processes), ``machine_s_per_job`` (of all on this machine, database and store too) and
        ``share``: of the jobs a second that all processors could make of what one costs the machine with one worker.
        ``where`` tells them apart. Then *arrivals* and *scanners*, of :mod:`steradian.benchmarks.queueing_model`.
    """
    stages = [
        f"{SINGLE_SERVICE}: jobs",
        f"{SINGLE_SERVICE}: clients",
        "nodes: jobs",
        "nodes: jobs by chance",
        "nodes: clients",
    ]
    stages.append(f"nodes: {WORKERS} workers")

    def at(stage: int) -> None:
        if progress is not None:
            progress(stages[stage], stage, len(stages))

    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="steradian-benchmark-") as folder:
        at(0)
        alone = Settings.create(data=Path(folder) / "alone", port=0, workers=1, simulator_speed=1.0)
        with running_service(alone) as service:
            scan = make_scan(service, count=POINTS, samples=SAMPLES)
            rows.append(_jobs("folder, 1 worker", service, scan, jobs, 1, service.processor_seconds))
            held = service.request("/storage")["used_bytes"]
            at(1)
            rows += _clients(SINGLE_SERVICE, [service], seconds, clients, streams)
        at(2)
        with (
            _nodes(Path(folder), shared) as (apis, used, add_worker),
            closing(Database(metadata_url(apis[0].settings))) as database,
        ):
            add_worker()
            log = EventLog(database)
            unscanned = log.bounds().last
            scan = make_scan(apis[0], count=POINTS, samples=SAMPLES)
            scanned = log.bounds().last
            rows.append(timed := _jobs("store, 1 worker", apis[0], scan, jobs, 1, used))
            done = log.bounds().last
            at(3)
            rows.append(
                came := measure_poisson_arrivals(apis[0], scan, MODES, jobs=2 * jobs, lasts=timed["seconds_per_job"])
            )
            at(4)
            rows += (met := _clients(MULTI_NODE, apis, seconds, clients, streams))
            many = load_of_scanners(
                came["lasting_s"],
                api_cpu_s=1e-3 * next(row["api_cpu_ms_per_request"] for row in met if row["case"] == "total"),
                scan_bytes=held["scans"],
                volume_bytes=held["reconstructions"] / (jobs + WARMUP_JOBS),
                events=scanned - unscanned + JOBS * (done - scanned) / (jobs + WARMUP_JOBS),
                event_s=_event_seconds(database),
            )
            at(5)
            for _ in range(WORKERS - 1):
                add_worker()
            rows.append(_jobs(f"store, {WORKERS} workers", apis[0], scan, jobs, WORKERS, used))
    return [*_with_shares(rows), *many]


def _event_seconds(database: Database) -> float:
    """Return the mean duration of a transaction that writes one event."""
    took = []
    for number in range(EVENTS):
        begun = time.perf_counter()
        with database.write() as session:
            append_event(session, datetime.now(UTC), "scanner", "benchmark", {"number": number})
        took.append(time.perf_counter() - begun)
    return fmean(took)


@contextmanager
def _nodes(
    folder: Path, shared: dict[str, Any]
) -> Iterator[tuple[list[RunningService], Callable[[], float], Callable[[], None]]]:
    """Run two API nodes and a scanner node.

    Yields the API nodes, the processor time of all, and a function that adds a worker.
    """
    common = shared | {"node_secret": secrets.token_hex(16), "port": 0, "simulator_speed": 1.0}
    with ExitStack() as stack:

        def node(name: str, role: str) -> RunningService:
            settings = Settings.create(data=folder / name, workers=0, **common)
            return stack.enter_context(running_service(settings, role))

        scanner = node("scanner", "acquisition")
        apis = [node("first", "api"), node("second", "api")]
        pids = [each.pid for each in (scanner, *apis)]

        def add_worker() -> None:
            name = f"far-{len(pids)}"
            settings = Settings.create(data=folder / name, worker_name=name, **shared)
            pids.append(stack.enter_context(running_worker(settings)))

        yield apis, lambda: sum(processor_seconds(pid) for pid in pids), add_worker


def _clients(where: str, services: Sequence[RunningService], seconds: float, clients: int, streams: int) -> list[Row]:
    rows = asyncio.run(mixed(services, create_fixtures(services[0]), seconds, clients, streams))
    return [row | {"where": where} for row in rows]


def _jobs(where: str, service: RunningService, scan: str, jobs: int, workers: int, used: Callable[[], float]) -> Row:
    run_through_service(service, scan, WARMUP_JOBS * workers, MODES)
    begun, before, busy = time.monotonic(), used(), busy_seconds()
    run_through_service(service, scan, jobs, MODES)
    took = time.monotonic() - begun
    spent, of_all = (used() - before) / jobs, (busy_seconds() - busy) / jobs
    return {
        "case": "jobs",
        "where": where,
        "workers": workers,
        "jobs": jobs,
        "seconds_per_job": took / jobs,
        "jobs_per_second": jobs / took,
        "cpu_s_per_job": spent,
        "machine_s_per_job": of_all,
    }


def _with_shares(rows: list[Row]) -> list[Row]:
    """Return rows with job rate relative to the machine's capacity, and object-store cost relative to the folder's."""
    timed = [row for row in rows if row["case"] == "jobs"]
    folder, store = timed[:2]
    for row in timed:
        alone = folder if row is folder else store
        row["share"] = row["jobs_per_second"] * alone["machine_s_per_job"] / (os.cpu_count() or 1)
        row["over_folder_s"] = row["seconds_per_job"] - folder["seconds_per_job"] if row["workers"] == 1 else None
    return rows
