"""The queue under load: ``python -m steradian.benchmarks.queue throughput | load``.

``throughput`` reconstructs one 1,605-point scan again and again through the whole service on two workers, and in a
loop in two processes that call the library, and compares. ``load`` gives 400 short jobs to four workers while eight
clients read how they stand.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from steradian.settings import Settings

LOOP = """
import sys, time
from pathlib import Path
from steradian.reconstructions.job import reconstruct_recording, reconstruct_scan
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.scans.recording import open_recording
scan, output, count, modes, bare = Path(sys.argv[1]), Path(sys.argv[2]), *map(int, sys.argv[3:])
def once(name):
    if bare:
        reconstruct_recording(open_recording(scan), ReconstructionParameters(modes=modes))
    else:
        reconstruct_scan(scan, output / name, ReconstructionParameters(modes=modes))
once("warm")
print("ready", flush=True)
sys.stdin.readline()
for number in range(count):
    once(str(number))
"""


@contextmanager
def running_service(settings: Settings) -> Iterator[str]:
    """Run ``steradian serve`` and yield the address of its API."""
    command = [sys.executable, "-m", "steradian", "serve"]
    process = subprocess.Popen(command, env=settings.environment(), stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None  # noqa: S101 - asked for
        yield process.stdout.readline().partition(" at ")[2].split()[0].rstrip("/")
    finally:
        process.terminate()
        process.wait(20)


def ask(url: str, body: dict[str, Any] | None = None, **headers: str) -> Any:
    """Send a request and return the JSON of the answer."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"Content-Type": "application/json", **headers})  # noqa: S310
    with urllib.request.urlopen(request, timeout=200) as answer:  # noqa: S310 - our own service
        return json.load(answer)


def make_scan(url: str, *, count: int, samples: int) -> str:
    """Scan an equi-steradian mask on the simulated scanner; returns the scan's identifier."""
    mask = ask(f"{url}/masks", {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": count})
    plan = ask(f"{url}/plans", {"mask_id": mask["id"], "samples": samples, "pulse_rate": 200})
    key = {"Idempotency-Key": f"benchmark-{os.getpid()}-{time.time_ns()}", "Prefer": "wait=120"}
    scan = ask(f"{url}/scans", {"plan_id": plan["id"]}, **key)
    while scan["state"] not in {"complete", "failed", "interrupted"}:
        scan = ask(f"{url}/scans/{scan['id']}", Prefer="wait=60")
    if scan["state"] != "complete":
        raise RuntimeError(f"the scan is {scan['state']}: {scan['error']}")
    return str(scan["id"])


def through_service(url: str, scan_id: str, jobs: int, modes: int) -> float:
    """Return the seconds from the first request to the end of the last job."""
    begun, made = time.monotonic(), []
    for _ in range(jobs):
        made.append(ask(f"{url}/reconstructions", {"scan_id": scan_id, "parameters": {"modes": modes}})["id"])
    for identifier in made:
        while (job := ask(f"{url}/reconstructions/{identifier}", Prefer="wait=60"))["state"] in {"queued", "running"}:
            pass
        if job["state"] != "succeeded":
            raise RuntimeError(f"{identifier} is {job['state']}: {job['error']}")
    return time.monotonic() - begun


def in_a_loop(scan: Path, jobs: int, modes: int, settings: Settings, *, bare: bool) -> float:
    """Return the seconds that two processes need which share the jobs and call the library.

    With ``bare`` the volumes stay in memory: nothing is written or drawn, which every job of the service does.
    """
    threads = {"NUMBA_NUM_THREADS": str(settings.threads_per_job), "OMP_NUM_THREADS": str(settings.threads_per_job)}
    with tempfile.TemporaryDirectory(dir=settings.data) as folder:
        loops = []
        for number in range(2):
            share = str(jobs // 2 + (jobs % 2) * number)
            command = [sys.executable, "-c", LOOP, str(scan), f"{folder}/{number}", share, str(modes), str(int(bare))]
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
            loops.append(subprocess.Popen(command, env=os.environ | threads, text=True, **pipes))  # type: ignore[call-overload]
        for loop in loops:
            loop.stdout.readline()
        begun = time.monotonic()
        for loop in loops:
            loop.stdin.write("go\n")
            loop.stdin.flush()
        for loop in loops:
            if loop.wait() != 0:
                raise RuntimeError("the loop failed")
        return time.monotonic() - begun


def throughput(settings: Settings, jobs: int, modes: int, points: int) -> dict[str, float]:
    """Compare the service with the loop in one run, both with warm processes."""
    with running_service(settings) as url:
        scan_id = make_scan(url, count=points, samples=1024)
        through_service(url, scan_id, 4, modes)  # both workers have their kernels
        service = through_service(url, scan_id, jobs, modes)
        scan = settings.data / "scans" / f"{scan_id}.h5"
        loop = in_a_loop(scan, jobs, modes, settings, bare=False)
        bare = in_a_loop(scan, jobs, modes, settings, bare=True)
    figures = {"jobs": jobs, "service_s": service, "loop_s": loop, "ratio": loop / service}
    return figures | {"bare_loop_s": bare, "bare_ratio": bare / service}


def load(settings: Settings, jobs: int, readers: int) -> dict[str, float]:
    """Queue many short jobs, read how they stand meanwhile, and check that none is lost or doubled."""
    from sqlalchemy import text

    from steradian.storage.database import Database, metadata_url

    settings = settings.model_copy(update={"workers": 4})
    with running_service(settings) as url:
        scan_id = make_scan(url, count=60, samples=128)
        over = threading.Event()
        made: list[str] = []
        reads: list[float] = []
        threads = [threading.Thread(target=_read, args=(url, made, over, reads)) for _ in range(readers)]
        for thread in threads:
            thread.start()
        begun = time.monotonic()
        body = {"scan_id": scan_id, "parameters": {"modes": 8}}
        made += [ask(f"{url}/reconstructions", body)["id"] for _ in range(jobs)]
        queued = time.monotonic() - begun
        views = [ask(f"{url}/reconstructions/{job}", Prefer="wait=120") for job in made]
        took = time.monotonic() - begun
        over.set()
        for thread in threads:
            thread.join()
    database = Database(metadata_url(settings))
    bare = []
    for identifier in made * 3:
        start = time.perf_counter()
        with database.engine.connect() as connection:
            connection.execute(text("SELECT * FROM jobs WHERE id = :id"), {"id": identifier}).all()
        bare.append(time.perf_counter() - start)
    database.close()
    starts = [_seconds_to_start(view) for view in views]
    return {
        "succeeded": sum(view["state"] == "succeeded" for view in views),
        "doubled": sum([entry["state"] for entry in view["history"]].count("running") != 1 for view in views),
        "enqueue_s": queued,
        "all_s": took,
        "reads": len(reads),
        "read_p50_ms": 1e3 * statistics.median(reads),
        "read_p99_ms": 1e3 * statistics.quantiles(reads, n=100)[98],
        "bare_select_p99_ms": 1e3 * statistics.quantiles(bare, n=100)[98],
        "first_start_s": min(starts),
    }


def _read(url: str, made: list[str], over: threading.Event, reads: list[float]) -> None:
    while not over.wait(0.02):
        if made:
            start = time.perf_counter()
            ask(f"{url}/reconstructions/{made[len(reads) % len(made)]}")
            reads.append(time.perf_counter() - start)


def _seconds_to_start(view: dict[str, Any]) -> float:
    from datetime import datetime

    return (datetime.fromisoformat(view["started"]) - datetime.fromisoformat(view["created"])).total_seconds()


def main() -> None:
    """Run one of the two and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["throughput", "load"])
    parser.add_argument("--jobs", type=int)
    parser.add_argument("--modes", type=int, default=226)
    parser.add_argument("--points", type=int, default=1600)
    parser.add_argument("--readers", type=int, default=8)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="steradian-benchmark-") as folder:
        settings = Settings.create(data=Path(folder), port=0, workers=2, simulator_speed=200.0)
        if given.what == "throughput":
            figures = throughput(settings, given.jobs or 20, given.modes, given.points)
        else:
            figures = load(settings, given.jobs or 400, given.readers)
    for name, value in figures.items():
        sys.stdout.write(f"{name:20} {value:10.3f}\n")


if __name__ == "__main__":
    main()
