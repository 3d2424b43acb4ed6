"""Launcher of a complete service in a temporary folder for benchmarks, with measurement of processor time."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from steradian.core.exceptions import SteradianError
from steradian.core.settings import Settings

UNFINISHED_STATES = frozenset({"queued", "running", "cancelling"})


@dataclass(frozen=True)
class RunningService:
    """Running service: URL of its API, and its root process."""

    url: str
    pid: int
    settings: Settings

    def request(self, path: str, body: dict[str, Any] | None = None, **headers: str) -> Any:
        """Send an HTTP request and return the JSON of the response."""
        return ask(f"{self.url}{path}", body, **headers)

    def processor_seconds(self) -> float:
        """Return the processor time of all its processes, ended ones included; 0 if unknown."""
        return processor_seconds(self.pid)


@contextmanager
def running_service(settings: Settings) -> Iterator[RunningService]:
    """Run ``steradian serve`` until the block ends."""
    command = [sys.executable, "-P", "-m", "steradian", "serve"]
    process = subprocess.Popen(
        command, env=settings.environment(), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    try:
        assert process.stdout is not None
        said = iter(process.stdout.readline, "")
        url = next((found[0] for line in said if (found := re.search(r"http://\S+/api/v1", line))), None)
        if url is None:
            raise SteradianError("the service did not start")
        yield RunningService(url, process.pid, settings)
    finally:
        process.terminate()
        process.communicate(timeout=20)


def ask(url: str, body: dict[str, Any] | None = None, **headers: str) -> Any:
    """Send an HTTP request and return the JSON of the response."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"Content-Type": "application/json", **headers})  # noqa: S310
    with urllib.request.urlopen(request, timeout=200) as answer:  # noqa: S310 - our own service
        return json.load(answer)


def make_scan(service: RunningService, *, count: int, samples: int) -> str:
    """Run a scan of an equi-steradian mask on the simulated scanner; return the scan's identifier."""
    equi = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": count}
    mask = service.request("/masks", equi)
    plan = service.request("/plans", {"mask_id": mask["id"], "samples": samples, "pulse_rate": 200})
    key = {"Idempotency-Key": f"benchmark-{os.getpid()}-{time.time_ns()}", "Prefer": "wait=120"}
    scan = service.request("/scans", {"plan_id": plan["id"]}, **key)
    while scan["state"] not in {"complete", "partial", "failed", "aborted", "interrupted"}:
        scan = service.request(f"/scans/{scan['id']}", Prefer="wait=60")
    if scan["state"] != "complete":
        raise SteradianError(f"the scan is {scan['state']}: {scan['error']}")
    return str(scan["id"])


def wait_for_reconstruction(service: RunningService, identifier: str) -> dict[str, Any]:
    """Wait until a reconstruction has ended; raises :class:`SteradianError` if it failed."""
    while (job := service.request(f"/reconstructions/{identifier}", Prefer="wait=60"))["state"] in UNFINISHED_STATES:
        pass
    if job["state"] != "succeeded":
        raise SteradianError(f"{identifier} is {job['state']}: {job['error']}")
    found: dict[str, Any] = job
    return found


def processor_seconds(pid: int) -> float:
    """Return the processor time of a process and its descendants, in s; 0 if unknown."""
    table: dict[int, tuple[int, float]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, ValueError, IndexError):
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            ticks = sum(map(int, fields[11:15]))  # own, and of ended children
            table[int(folder.name)] = (int(fields[1]), ticks / os.sysconf("SC_CLK_TCK"))
    family, found = {pid}, 0
    while len(family) != found:
        found = len(family)
        family |= {child for child, (parent, _) in table.items() if parent in family}
    return sum(table[member][1] for member in family if member in table)
