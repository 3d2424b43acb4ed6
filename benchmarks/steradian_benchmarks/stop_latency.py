"""Benchmark of the emergency stop: time from the request to the last laser shot, by the simulator's clock."""

from __future__ import annotations

import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from fabry_perot.simulator import Simulator, launch
from steradian.core.exceptions import SteradianError
from steradian.core.progress import Progress
from steradian.core.settings import Settings
from steradian_benchmarks.service import RunningService, ask, running_service

PULSE_RATE = 1000.0
STOP = "/scanners/scanner-0/emergency-stop"
PATIENCE = 60.0
_BUSY_LOOP = "while True: pass"
_OVER = frozenset({"aborted", "interrupted", "complete", "failed"})


def stop(*, presses: int = 25, progress: Progress | None = None) -> list[dict[str, Any]]:
    """Measure the emergency stop during scans at 1 kHz: on an idle machine, under CPU load, with a locked database.

    Parameters
    ----------
    presses
        Scans that are stopped under each condition.

    Returns
    -------
    list of dict
        Per condition the milliseconds from the request to the laser's last shot, by the scanner's clock, and to the
        answer; how often the scanner's confirmation was in it; and what the last shot must not exceed.
    """
    conditions: dict[str, tuple[Callable[[Path], AbstractContextManager[None]], float]] = {
        "idle": (lambda _: nullcontext(), 100.0),
        "two busy processes": (lambda _: _cpu_load(), 250.0),
        "database locked": (_database_locked, 100.0),
    }
    rows = []
    with tempfile.TemporaryDirectory(prefix="steradian-benchmark-") as folder, launch(tcp="127.0.0.1:0") as scanner:
        settings = Settings.create(data=Path(folder), port=0, workers=1, scanner=scanner.url)
        with running_service(settings) as service:
            for number, (name, (under, limit)) in enumerate(conditions.items()):
                found = []
                for done in range(presses):
                    if progress is not None:
                        progress(name, number * presses + done, len(conditions) * presses)
                    found.append(_press(service, scanner, under))
                rows.append(_row(name, found, limit))
    return rows


def _row(name: str, found: list[tuple[float, float, bool]], limit: float) -> dict[str, Any]:
    dark, answered = sorted(row[0] for row in found), sorted(row[1] for row in found)
    return {
        "case": name,
        "presses": len(found),
        "last_shot_p50_ms": statistics.median(dark),
        "last_shot_max_ms": dark[-1],
        "limit_ms": limit,
        "answer_p50_ms": statistics.median(answered),
        "answer_max_ms": answered[-1],
        "confirmed": sum(row[2] for row in found),
    }


def _press(
    service: RunningService, scanner: Simulator, under: Callable[[Path], AbstractContextManager[None]]
) -> tuple[float, float, bool]:
    """Stop one scan; return the milliseconds to the last shot and to the response, and whether it was confirmed."""
    scan = _start(service, scanner)
    with under(service.settings.data):
        before, begun = _read_simulator(scanner)["time"], time.monotonic()
        answer = service.request(STOP, {"reason": "benchmark"})
        answered = time.monotonic() - begun
    last = _read_simulator(scanner)["last_shot"]
    _until(lambda: service.request(f"/scans/{scan}")["state"] in _OVER)
    _release(service)
    return max(0.0, (last - before) / 1e3), 1e3 * answered, answer["emergency_stop"]["laser"] == "off"


def _start(service: RunningService, scanner: Simulator) -> str:
    """Start a scan and return its identifier when the laser fires."""
    equi = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 5000}
    mask = service.request("/masks", equi)
    plan = service.request("/plans", {"mask_id": mask["id"], "samples": 256, "pulse_rate": PULSE_RATE, "averages": 4})
    shots = _read_simulator(scanner)["shots"]
    scan = service.request("/scans", {"plan_id": plan["id"]}, **{"Idempotency-Key": f"stop-{time.time_ns()}"})
    _until(lambda: _read_simulator(scanner)["shots"] > shots + 20)
    return str(scan["id"])


def _read_simulator(scanner: Simulator) -> dict[str, Any]:
    """Return the simulated scanner's clock and counters, without its list of shots, which is slow to read."""
    return scanner.send_command("report", fired=False)


def _release(service: RunningService) -> None:
    request = urllib.request.Request(f"{service.url}{STOP}", method="DELETE")  # noqa: S310 - our own service
    with urllib.request.urlopen(request, timeout=PATIENCE):  # noqa: S310
        pass
    if ask(f"{service.url}/scanners/scanner-0")["emergency_stop"] is not None:
        raise SteradianError("the emergency stop was released and stands")


def _until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            raise SteradianError(f"the scan did not get there within {PATIENCE:g} s")
        time.sleep(0.02)


@contextmanager
def _cpu_load() -> Iterator[None]:
    """Load two processors with busy loops until the block ends."""
    processes = [subprocess.Popen([sys.executable, "-c", _BUSY_LOOP]) for _ in range(2)]
    try:
        time.sleep(0.2)
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


@contextmanager
def _database_locked(folder: Path) -> Iterator[None]:
    """Hold the database's write lock until the block ends."""
    with closing(sqlite3.connect(folder / "steradian.sqlite", isolation_level=None, timeout=30)) as holder:
        holder.execute("BEGIN EXCLUSIVE")
        try:
            yield
        finally:
            holder.execute("ROLLBACK")
