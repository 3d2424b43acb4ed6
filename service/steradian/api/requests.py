"""What a job must pass before it is queued, and how it is noted: reconstructions, single or in batches, and others."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from sqlalchemy.orm import Session

from steradian.api.problems import NotReady
from steradian.api.services import Services
from steradian.errors import Conflict, InvalidInput, NotFound
from steradian.jobs.kinds import LIVE, WHAT_IF
from steradian.jobs.model import JobRequest
from steradian.jobs.requests import Live, WhatIf
from steradian.jobs.submissions import reconstruction_job
from steradian.reconstructions.parameters import DEFAULT_SPACING, ReconstructionParameters
from steradian.security.keys import Principal
from steradian.storage.states import SETTLED_SCAN_STATES, ReconstructionState
from steradian.storage.tables import BatchRow, JobRow, ReconstructionRow, ScanRow


@dataclass(frozen=True)
class Wanted:
    """A reconstruction that somebody asks for; see :class:`steradian.api.reconstructions.ReconstructionRequest`."""

    parameters: ReconstructionParameters
    follow: bool = False
    interval: float = 2.0
    mask_id: str | None = None
    points: Literal["nearest", "exact"] = "nearest"
    frame: int | None = None


def check_request(services: Services, scan_id: str, wanted: Wanted) -> ScanRow:
    """Refuse what cannot work: a scan still running (unless it is to be followed) or empty, a volume too large.

    Raises
    ------
    NotFound, NotReady, Conflict, InvalidInput
        In that order.
    """
    scan = services.scans.get(scan_id)
    if scan.state not in SETTLED_SCAN_STATES and not wanted.follow:
        text = f"scan {scan.id} is {scan.state}; it can be reconstructed when it is over, or followed"
        raise NotReady(text)
    if scan.state in SETTLED_SCAN_STATES:
        check_alines(services, scan)
    check_parts(services, scan, wanted)
    return scan


def check_alines(services: Services, scan: ScanRow) -> None:
    """Refuse a scan without A-lines; raises :class:`Conflict`."""
    if not services.data.scan_file(scan.id).is_file() or not (scan.summary or {}).get("stored", scan.done):
        raise Conflict(f"scan {scan.id} is {scan.state} and holds no A-lines")


def check_parts(services: Services, scan: ScanRow, wanted: Wanted) -> None:
    """Refuse a volume that is too large, a mask or frame that does not exist; raises :class:`InvalidInput`."""
    plan, mask = services.plans.get(scan.plan_id), services.masks.get(scan.mask_id)
    parameters = wanted.parameters
    modes = parameters.modes or max(2, round(mask.aperture / DEFAULT_SPACING))
    size = 4 * (modes * parameters.upsampling) ** 2 * plan.parameters["samples"] * parameters.upsampling
    limit = services.settings.max_volume_bytes
    if size > limit:
        raise InvalidInput("parameters.modes", modes, f"a volume of at most {limit} bytes, not {size}")
    frames = frames_of(plan.parameters)
    if wanted.frame is not None and wanted.frame >= len(frames):
        raise InvalidInput("frame", wanted.frame, f"0 to {len(frames) - 1}; the scan has {len(frames)}")
    if wanted.mask_id is not None:
        other = services.masks.get(wanted.mask_id)
        if abs(other.aperture - mask.aperture) > 1e-6 * mask.aperture:
            raise InvalidInput("through.mask_id", wanted.mask_id, f"a mask of the scan's aperture, {mask.aperture:g} m")


def frames_of(plan: dict[str, Any]) -> list[float]:
    """Return the excitation wavelength of each frame in m, 0 where the laser stays as it stands."""
    return [value for value in plan.get("excitation") or (0.0,) for _ in range(plan.get("frames", 1))]


def note_request(
    services: Services,
    session: Session,
    scan: ScanRow,
    wanted: Wanted,
    who: Principal,
    *,
    batch: BatchRow | None = None,
    priority: int,
    timeout: float | None = None,
) -> tuple[ReconstructionRow, JobRow]:
    """Note a reconstruction and its job in the present transaction."""
    row = services.reconstructions.add(session, scan, wanted.parameters.model_dump(mode="json"), batch)
    how: dict[str, Any] = {"priority": priority, "timeout": timeout, "principal": who.name}
    about: dict[str, Any] = {"batch_id": row.batch_id}
    if wanted.follow:
        live = Live(scan_id=scan.id, parameters=wanted.parameters, interval=wanted.interval)
        request = JobRequest(row.id, LIVE, live.model_dump(mode="json") | about, **how)
    elif wanted.mask_id is not None:
        through = WhatIf(scan_id=scan.id, mask_id=wanted.mask_id, points=wanted.points, parameters=wanted.parameters)
        request = JobRequest(row.id, WHAT_IF, through.model_dump(mode="json") | about, **how)
    else:
        file = services.data.scan_file(scan.id)
        request = reconstruction_job(
            row.id, services.settings, file, wanted.parameters, frame=wanted.frame, scan_id=scan.id, **about, **how
        )
    job = services.ledger.add(session, request)
    session.flush()
    return row, job


def existing_volume(services: Services, reconstruction_id: str, field: str) -> Path:
    """Find the volume that a reconstruction left.

    Raises
    ------
    NotFound, NotReady, Conflict
        When there is no such reconstruction, or no volume of it yet, or there will be none.
    InvalidInput
        When it is larger than a job may read.
    """
    services.reconstructions.get(reconstruction_id)
    job = services.ledger.status(reconstruction_id)
    if not job.is_over:
        raise NotReady(f"{field} {reconstruction_id} is {job.state}; its volume can be used when it has succeeded")
    if job.state is not ReconstructionState.SUCCEEDED:
        raise Conflict(f"{field} {reconstruction_id} has {job.state} and left no volume")
    path = services.data.job(reconstruction_id).volume
    if not path.is_file():
        raise NotFound("volume of", reconstruction_id)
    if path.stat().st_size > 2 * services.settings.max_volume_bytes:
        raise InvalidInput(field, reconstruction_id, f"a volume of at most {services.settings.max_volume_bytes} bytes")
    return path
