"""Benchmark of the job queue: throughput, latency, progress latency and behaviour under load."""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from steradian.core.exceptions import SteradianError
from steradian.core.progress import Progress
from steradian.core.settings import Settings
from steradian.jobs.job import JobStatus
from steradian_benchmarks.progress_latency_job import TURN, milliseconds
from steradian_benchmarks.service import RunningService, make_scan, running_service, wait_for_reconstruction

CLOCK = (sys.executable, "-P", "-m", "steradian_benchmarks.progress_latency_job")
WORKER = f"""
from steradian.core.settings import Settings
from steradian.jobs.worker.main import run_worker
run_worker(Settings.create(), 0, {{"clock": {CLOCK!r}}})
"""
READ_EVERY = 0.02


def queue(
    *, jobs: int = 20, load_jobs: int = 400, database_url: str | None = None, progress: Progress | None = None
) -> list[dict[str, Any]]:
    """Measure throughput, latency and load of the job queue, each in a separate folder.

    Parameters
    ----------
    jobs
        Reconstructions of the paper's yarn (1,605 points, 226² modes, 1,024 samples) on two workers of a service.
    load_jobs
        Short jobs for four workers while eight clients read.
    database_url
        A PostgreSQL database; none: SQLite files.
    """
    rows = []
    with tempfile.TemporaryDirectory(prefix="steradian-benchmark-") as folder:
        given = {"port": 0, "simulator_speed": 200.0, "database_url": database_url}
        if jobs:
            settings = Settings.create(data=Path(folder) / "throughput", workers=2, **given)
            rows.append(throughput(settings, jobs=jobs, progress=progress))
        rows.append(latency(Settings.create(data=Path(folder) / "latency", **given), progress=progress))
        if load_jobs:
            settings = Settings.create(data=Path(folder) / "load", workers=4, **given)
            rows.append(load(settings, jobs=load_jobs, progress=progress))
    return rows


def throughput(
    settings: Settings, *, jobs: int = 20, modes: int = 226, points: int = 1600, progress: Progress | None = None
) -> dict[str, Any]:
    """Measure jobs per second and processor time per job of reconstructions through a service with warm workers."""
    with running_service(settings) as service:
        scan_id = make_scan(service, count=points, samples=1024)
        _reconstruct(service, scan_id, 2 * settings.workers, modes, None)  # every worker has its kernels
        begun, before = time.monotonic(), service.processor_seconds()
        _reconstruct(service, scan_id, jobs, modes, progress)
        seconds, used = time.monotonic() - begun, service.processor_seconds() - before
    return {
        "case": "throughput",
        "jobs": jobs,
        "seconds": seconds,
        "jobs_per_second": jobs / seconds,
        "cpu_s_per_job": used / jobs,
    }


def _reconstruct(service: RunningService, scan_id: str, jobs: int, modes: int, progress: Progress | None) -> None:
    """Submit reconstructions to the service and wait for all of them."""
    body = {"scan_id": scan_id, "parameters": {"modes": modes}}
    made = [service.request("/reconstructions", body)["id"] for _ in range(jobs)]
    for number, identifier in enumerate(made):
        if progress:
            progress("throughput", number, jobs)
        wait_for_reconstruction(service, identifier)


def latency(settings: Settings, *, jobs: int = 30, progress: Progress | None = None) -> dict[str, Any]:
    """Measure how long a job waits for an idle worker, and the age of progress reports when readable."""
    from steradian.jobs.job import JobRequest
    from steradian.jobs.queue.queue_client import JobQueue

    client = JobQueue(settings)
    starts: list[float] = []
    try:
        with _clock_worker(settings):
            for number in range(jobs):
                if progress:
                    progress("latency", number, jobs)
                client.submit(JobRequest(f"short-{number}", "clock", {"seconds": 0.0, "every": 0.1}))
                status = client.wait(f"short-{number}", timeout=60)
                starts.append(_waited(status))
                time.sleep(0.6)  # the worker is idle again, not in the hurry after a job
            lags = _lags(client, JobRequest("long", "clock", {"seconds": 6.0, "every": 0.05}))
    finally:
        client.close()
    return {"case": "latency", "jobs": jobs} | _spread("start", starts[1:]) | _spread("progress", lags)


def _lags(client: Any, request: Any) -> list[float]:
    """Return the age in seconds of each progress report when first read."""
    client.submit(request)
    seen, lags = 0, []
    while not (status := client.status(request.id)).is_over:
        if status.stage == "clock" and status.done != seen:
            seen = status.done
            lags.append((milliseconds() - seen) % TURN / 1e3)
        time.sleep(0.005)
    return lags


@contextmanager
def _clock_worker(settings: Settings) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, "-c", WORKER], env=settings.environment(), stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.terminate()
        process.wait(10)


def load(settings: Settings, *, jobs: int = 400, readers: int = 8, progress: Progress | None = None) -> dict[str, Any]:
    """Submit many short jobs, poll their states, and check that each is executed exactly once."""
    with running_service(settings) as service:
        scan_id = make_scan(service, count=60, samples=128)
        over = threading.Event()
        made: list[str] = []
        reads: list[float] = []
        threads = [threading.Thread(target=_read, args=(service, made, over, reads)) for _ in range(readers)]
        for thread in threads:
            thread.start()
        begun = time.monotonic()
        body = {"scan_id": scan_id, "parameters": {"modes": 8}}
        made += [service.request("/reconstructions", body)["id"] for _ in range(jobs)]
        queued, views = time.monotonic() - begun, []
        for number, job in enumerate(made):
            if progress:
                progress("load", number, jobs)
            views.append(service.request(f"/reconstructions/{job}", Prefer="wait=120"))
        took = time.monotonic() - begun
        over.set()
        for thread in threads:
            thread.join()
    return {
        "case": "load",
        "jobs": jobs,
        "seconds": took,
        "jobs_per_second": jobs / took,
        "succeeded": sum(view["state"] == "succeeded" for view in views),
        "doubled": sum([entry["state"] for entry in view["history"]].count("running") != 1 for view in views),
        "submit_s": queued,
        "reads": len(reads),
        **_spread("read", reads),
        **_spread("bare_select", _bare_selects(settings, made)),
        "first_start_s": min(_seconds_to_start(view) for view in views),
    }


def _bare_selects(settings: Settings, made: Sequence[str]) -> list[float]:
    """Return the durations in seconds of reading a job's row on an idle database."""
    from sqlalchemy import text

    from steradian.storage.db.database import Database, metadata_url

    database, seconds = Database(metadata_url(settings)), []
    for identifier in [*made, *made, *made]:
        start = time.perf_counter()
        with database.engine.connect() as connection:
            connection.execute(text("SELECT * FROM jobs WHERE id = :id"), {"id": identifier}).all()
        seconds.append(time.perf_counter() - start)
    database.close()
    return seconds


def _read(service: RunningService, made: list[str], over: threading.Event, reads: list[float]) -> None:
    while not over.wait(READ_EVERY):
        if made:
            start = time.perf_counter()
            service.request(f"/reconstructions/{made[len(reads) % len(made)]}")
            reads.append(time.perf_counter() - start)


def _spread(name: str, seconds: Sequence[float]) -> dict[str, float]:
    """Return median and 99th percentile in milliseconds."""
    if len(seconds) < 2:
        return {}
    return {
        f"{name}_p50_ms": 1e3 * statistics.median(seconds),
        f"{name}_p99_ms": 1e3 * statistics.quantiles(seconds, n=100, method="inclusive")[98],
    }


def _waited(status: JobStatus) -> float:
    if status.started is None or status.created is None:
        raise SteradianError(f"{status.id} is {status.state} and never began")
    return (status.started - status.created).total_seconds()


def _seconds_to_start(view: dict[str, Any]) -> float:
    return (datetime.fromisoformat(view["started"]) - datetime.fromisoformat(view["created"])).total_seconds()
