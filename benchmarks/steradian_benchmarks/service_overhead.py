"""Benchmark of reconstructions through the service, against a loop that calls the library.

Both reconstruct one scan again and again, on two workers and in two processes, with as many threads each. The loop does
what a job does for a person, :func:`steradian.reconstructions.pipeline.run.reconstruct_scan`: read the scan's file,
reconstruct, write the volume, draw three projections, write the report. Two more loops say what that costs: one keeps
the plan, as the service's workers do, and one leaves the volume in memory.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from steradian.core.exceptions import SteradianError
from steradian.core.progress import Progress
from steradian.core.settings import Settings
from steradian_benchmarks.service import (
    RunningService,
    make_scan,
    processor_seconds,
    running_service,
    wait_for_reconstruction,
)

LOOPS = 2
ROUNDS = 4
KINDS = ("library loop, as a job does", "the same, plan kept", "volume in memory only")
PROGRAM = """
import sys
from pathlib import Path
from steradian.reconstructions.pipeline.run import reconstruct_in_memory, reconstruct_scan
from steradian.reconstructions.pipeline.plan_cache import PlanCache
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.scans.opening import open_recording
scan, output, modes, kind = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
parameters, plans = ReconstructionParameters(modes=modes), PlanCache() if kind == 1 else None
def once(number):
    if kind == 2:
        reconstruct_in_memory(open_recording(scan), parameters)
    else:
        reconstruct_scan(scan, output / str(number), parameters, plans=plans)
once(-1)
print("ready", flush=True)
done = 0
for line in sys.stdin:
    for _ in range(int(line)):
        once(done)
        done += 1
    print("done", flush=True)
"""


class LibraryLoop:
    """Reference loop: two processes that call the library and share the jobs."""

    def __init__(self, scan: Path, folder: Path, modes: int, kind: int, threads: int) -> None:
        limits = {"NUMBA_NUM_THREADS": str(threads), "OMP_NUM_THREADS": str(threads)}
        self._processes = [
            subprocess.Popen(
                [sys.executable, "-c", PROGRAM, str(scan), f"{folder}/{kind}-{number}", str(modes), str(kind)],
                env=os.environ | limits,
                text=True,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            for number in range(LOOPS)
        ]
        self._expect("ready")

    def run(self, jobs: int) -> None:
        """Run a number of reconstructions; return when the last is done."""
        for number, process in enumerate(self._processes):
            assert process.stdin is not None
            process.stdin.write(f"{jobs // LOOPS + (number < jobs % LOOPS)}\n")
            process.stdin.flush()
        self._expect("done")

    def processor_seconds(self) -> float:
        """Return the processor time used by the loop's processes."""
        return sum(processor_seconds(process.pid) for process in self._processes)

    def close(self) -> None:
        """Terminate the loop's processes."""
        for process in self._processes:
            process.kill()
            process.communicate()

    def _expect(self, word: str) -> None:
        for process in self._processes:
            assert process.stdout is not None
            if process.stdout.readline().strip() != word:
                raise SteradianError("a process of the library's loop failed")


def throughput(
    settings: Settings, *, jobs: int = 20, modes: int = 226, points: int = 1600, progress: Progress | None = None
) -> list[dict[str, Any]]:
    """Compare the throughput of service and library loop in alternating rounds of warm processes.

    Returns
    -------
    list of dict
        A row for each: ``seconds``, ``jobs_per_second``, processor ``cpu_s_per_job``, and ``ratio``: the service's
        throughput in units of this one's.
    """
    rounds = min(ROUNDS, jobs)
    shares = [jobs // rounds + (number < jobs % rounds) for number in range(rounds)]
    with _setups(settings, modes, points) as contestants:
        seconds, used = dict.fromkeys(contestants, 0.0), dict.fromkeys(contestants, 0.0)
        for turn, share in enumerate(shares):
            for name, (run, measure) in contestants.items():
                if progress:
                    progress(name, turn, rounds)
                begun, before = time.monotonic(), measure()
                run(share)
                seconds[name] += time.monotonic() - begun
                used[name] += measure() - before
    service = next(iter(contestants))
    return [
        {
            "case": name,
            "jobs": jobs,
            "seconds": seconds[name],
            "jobs_per_second": jobs / seconds[name],
            "cpu_s_per_job": used[name] / jobs,
            "ratio": seconds[name] / seconds[service],
        }
        for name in contestants
    ]


@contextmanager
def _setups(settings: Settings, modes: int, points: int) -> Iterator[dict[str, Any]]:
    with ExitStack() as stack:
        service = stack.enter_context(running_service(settings))
        scan_id = make_scan(service, count=points, samples=1024)
        run_through_service(service, scan_id, 2 * settings.workers, modes)  # every worker has its kernels
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=settings.data)))
        found: dict[str, Any] = {
            "service": (lambda jobs: run_through_service(service, scan_id, jobs, modes), service.processor_seconds)
        }
        for kind, name in enumerate(KINDS):
            loop = LibraryLoop(service.scan_file(scan_id), folder, modes, kind, settings.threads_per_job)
            stack.callback(loop.close)
            found[name] = (loop.run, loop.processor_seconds)
        yield found


def run_through_service(service: RunningService, scan_id: str, jobs: int, modes: int) -> None:
    """Submit reconstructions to the service and wait for the last."""
    body = {"scan_id": scan_id, "parameters": {"modes": modes}}
    made = [service.request("/reconstructions", body)["id"] for _ in range(jobs)]
    for identifier in made:
        wait_for_reconstruction(service, identifier)
