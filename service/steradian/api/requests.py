"""What a reconstruction must pass before it is queued, and how it is noted; single ones and batches alike."""

from __future__ import annotations

from typing import Any

from sqlalchemy.orm import Session

from steradian.api.problems import NotReady
from steradian.api.services import Services
from steradian.errors import Conflict, InvalidInput
from steradian.reconstructions.parameters import DEFAULT_SPACING, ReconstructionParameters
from steradian.reconstructions.worker import reconstruction_job
from steradian.storage.keys import Principal
from steradian.storage.states import SETTLED_SCAN_STATES
from steradian.storage.tables import BatchRow, JobRow, ReconstructionRow, ScanRow


def check_request(services: Services, scan_id: str, parameters: ReconstructionParameters) -> ScanRow:
    """Refuse what cannot work: a scan still running or empty, a volume too large.

    Raises
    ------
    NotFound, NotReady, Conflict, InvalidInput
        In that order.
    """
    scan = services.scans.get(scan_id)
    if scan.state not in SETTLED_SCAN_STATES:
        raise NotReady(f"scan {scan.id} is {scan.state}; it can be reconstructed when it is over")
    if not services.data.scan_file(scan.id).is_file() or not (scan.summary or {}).get("stored", scan.done):
        raise Conflict(f"scan {scan.id} is {scan.state} and holds no A-lines")
    check_size(services, scan, parameters)
    return scan


def check_size(services: Services, scan: ScanRow, parameters: ReconstructionParameters) -> None:
    """Refuse a volume that is too large; raises :class:`InvalidInput`."""
    plan, mask = services.plans.get(scan.plan_id), services.masks.get(scan.mask_id)
    modes = parameters.modes or max(2, round(mask.aperture / DEFAULT_SPACING))
    size = 4 * (modes * parameters.upsampling) ** 2 * plan.parameters["samples"] * parameters.upsampling
    limit = services.settings.max_volume_bytes
    if size > limit:
        raise InvalidInput("parameters.modes", modes, f"a volume of at most {limit} bytes, not {size}")


def note_request(
    services: Services,
    session: Session,
    scan: ScanRow,
    parameters: ReconstructionParameters,
    who: Principal,
    *,
    batch: BatchRow | None = None,
    **how: Any,
) -> tuple[ReconstructionRow, JobRow]:
    """Note a reconstruction and its job in the present transaction; ``how``: priority and timeout."""
    row = services.reconstructions.add(session, scan, parameters.model_dump(mode="json"), batch)
    file = services.data.scan_file(scan.id)
    about = {"scan_id": scan.id, "batch_id": row.batch_id, "principal": who.name, **how}
    job = services.ledger.add(session, reconstruction_job(row.id, services.settings, file, parameters, **about))
    session.flush()
    return row, job
