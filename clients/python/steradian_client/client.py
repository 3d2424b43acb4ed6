"""The client: the service's four nouns, one attribute each."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TypeVar

from steradian_client.errors import JobFailed
from steradian_client.models import Mask, Plan, Reconstruction, Scan
from steradian_client.transport import Transport

Report = Callable[[str, int, int], None]
"""Called as ``progress(stage, done, total)`` while waiting."""

Work = TypeVar("Work", Scan, Reconstruction)

LOOK_EVERY = 1.0
"""Longest that one request is held while waiting (s); progress is reported in between."""


class Client:
    """A connection to a Steradian service.

    Parameters
    ----------
    url
        Address of the service.
    key
        API key; a service on this machine needs none.
    timeout
        Seconds to wait for an answer.

    Examples
    --------
    >>> with Client("http://127.0.0.1:8000") as service:                       # doctest: +SKIP
    ...     mask = service.masks.equi_steradian(aperture=13.56e-3, depth=3.6e-3, count=1600)
    ...     scan = service.scans.wait(service.scans.create(service.plans.create(mask.id).id), progress=print)
    ...     job = service.reconstructions.wait(service.reconstructions.create(scan.id, modes=226), progress=print)
    ...     service.reconstructions.save_mip(job.id, Path("mip-z.png"), axis="z")
    """

    def __init__(self, url: str = "http://127.0.0.1:8000", *, key: str | None = None, timeout: float = 30.0) -> None:
        self._transport = Transport(url, timeout, key)
        self.masks = Masks(self._transport)
        self.plans = Plans(self._transport)
        self.scans = Scans(self._transport)
        self.reconstructions = Reconstructions(self._transport)

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Masks:
    """Where to sense."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def create(self, arrangement: str, **parameters: Any) -> Mask:
        """Make a mask of any arrangement; the same parameters give the same mask."""
        return self._transport.ask(Mask, "POST", "/masks", body={"arrangement": arrangement, **parameters})

    def equi_steradian(self, *, aperture: float, depth: float, count: int) -> Mask:
        """Make a mask of equal solid angles; ``aperture`` and ``depth`` of the point of interest in metres."""
        return self.create("equi-steradian", aperture=aperture, depth=depth, count=count)

    def grid(self, *, aperture: float, count: int, interval: float) -> Mask:
        """Make a grid of ``count`` × ``count`` points; ``aperture`` and ``interval`` in metres."""
        return self.create("grid", aperture=aperture, count=count, interval=interval)

    def get(self, mask_id: str) -> Mask:
        """Read one."""
        return self._transport.ask(Mask, "GET", f"/masks/{mask_id}")

    def list(self, limit: int = 100) -> list[Mask]:
        """Read the newest."""
        return self._transport.list(Mask, "/masks", limit)


class Plans:
    """In what order and how fast."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def create(self, mask_id: str, **parameters: Any) -> Plan:
        """Make a plan; parameters as of ``steradian.ScanPlan``, such as pulse_rate (Hz) or samples."""
        return self._transport.ask(Plan, "POST", "/plans", body={"mask_id": mask_id, **parameters})

    def get(self, plan_id: str) -> Plan:
        """Read one."""
        return self._transport.ask(Plan, "GET", f"/plans/{plan_id}")

    def list(self, limit: int = 100) -> list[Plan]:
        """Read the newest."""
        return self._transport.list(Plan, "/plans", limit)


class Scans:
    """Running plans on the scanner."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def create(self, plan_id: str, *, idempotency_key: str | None = None) -> Scan:
        """Queue a run of a plan.

        Parameters
        ----------
        idempotency_key
            Repeating the call with the same key finds the scan that the first call made; ``None`` makes a new key.
        """
        headers = {"Idempotency-Key": idempotency_key or str(uuid.uuid4())}
        return self._transport.ask(Scan, "POST", "/scans", body={"plan_id": plan_id}, headers=headers)

    def get(self, scan_id: str) -> Scan:
        """Read one."""
        return self._transport.ask(Scan, "GET", f"/scans/{scan_id}")

    def list(self, limit: int = 100) -> list[Scan]:
        """Read the newest."""
        return self._transport.list(Scan, "/scans", limit)

    def stop(self, scan_id: str, reason: str | None = None) -> Scan:
        """Stop a scan and keep what was measured."""
        return self._wish(scan_id, "stopped", reason)

    def abort(self, scan_id: str, reason: str | None = None) -> Scan:
        """Give a scan up."""
        return self._wish(scan_id, "aborted", reason)

    def wait(self, scan: Scan, *, progress: Report | None = None, timeout: float | None = None) -> Scan:
        """Wait until a scan is over.

        Parameters
        ----------
        progress
            Told of every advance, unit A-lines.
        timeout
            Seconds; ``None`` waits as long as it takes.

        Raises
        ------
        JobFailed
            When it ended without data to use.
        TimeoutError
            When it is not over in time; it goes on.
        """
        return _wait(self._transport, scan, f"/scans/{scan.id}", progress, timeout)

    def save_file(self, scan_id: str, target: Path) -> Path:
        """Download the scan file (HDF5)."""
        return self._transport.download(f"/scans/{scan_id}/file", target)

    def _wish(self, scan_id: str, state: str, reason: str | None) -> Scan:
        body = {"state": state, "reason": reason}
        return self._transport.ask(Scan, "PUT", f"/scans/{scan_id}/desired-state", body=body)


class Reconstructions:
    """Jobs that turn scans into volumes."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def create(self, scan_id: str, **parameters: Any) -> Reconstruction:
        """Queue a reconstruction; parameters such as modes, upsampling, method, sound_speed (m/s), tolerance."""
        body = {"scan_id": scan_id, "parameters": parameters}
        return self._transport.ask(Reconstruction, "POST", "/reconstructions", body=body)

    def get(self, reconstruction_id: str) -> Reconstruction:
        """Read one."""
        return self._transport.ask(Reconstruction, "GET", f"/reconstructions/{reconstruction_id}")

    def list(self, limit: int = 100) -> list[Reconstruction]:
        """Read the newest."""
        return self._transport.list(Reconstruction, "/reconstructions", limit)

    def cancel(self, reconstruction_id: str, reason: str | None = None) -> Reconstruction:
        """Cancel one that waits or runs."""
        body = {"state": "cancelled", "reason": reason}
        path = f"/reconstructions/{reconstruction_id}/desired-state"
        return self._transport.ask(Reconstruction, "PUT", path, body=body)

    def wait(
        self, reconstruction: Reconstruction, *, progress: Report | None = None, timeout: float | None = None
    ) -> Reconstruction:
        """Wait until a reconstruction is over; parameters and errors as of :meth:`Scans.wait`."""
        return _wait(self._transport, reconstruction, f"/reconstructions/{reconstruction.id}", progress, timeout)

    def save_mip(self, reconstruction_id: str, target: Path, *, axis: Literal["x", "y", "z"] = "z") -> Path:
        """Download a maximum-intensity projection (PNG)."""
        return self._transport.download(f"/reconstructions/{reconstruction_id}/mip", target, {"axis": axis})

    def save_volume(self, reconstruction_id: str, target: Path) -> Path:
        """Download the volume as a NumPy file, float32 [x, y, z]."""
        return self._transport.download(f"/reconstructions/{reconstruction_id}/volume", target)


def _wait(transport: Transport, work: Work, path: str, progress: Report | None, timeout: float | None) -> Work:
    """Look at ``path`` until the work there is over; the service holds each look until then, or a moment."""
    deadline = None if timeout is None else time.monotonic() + timeout
    while True:
        if progress is not None and work.progress.stage is not None:
            progress(work.progress.stage, work.progress.done, work.progress.total)
        if work.is_over:
            break
        left = LOOK_EVERY if deadline is None else min(LOOK_EVERY, deadline - time.monotonic())
        if left <= 0:
            raise TimeoutError(f"{work.id} is still {work.state}")
        work = transport.ask(type(work), "GET", path, wait=max(1.0, left))
    if not work.is_good:
        raise JobFailed(work.id, work.state, work.error.detail if work.error else None)
    return work
