"""Decision on the points of interest of a scan's stage."""

from __future__ import annotations

from steradian.api.schemas.scans import StageDecision
from steradian.api.services import ServiceContainer
from steradian.api.use_cases.scan_submission import require_lease
from steradian.core.exceptions import InvalidInput, NotFound
from steradian.security.keys import Principal
from steradian.storage.db.tables import ScanRow
from steradian.storage.repositories.scan_stages import ScanStageRepository

Points = list[tuple[float, float, float]]


def decide_stage(
    services: ServiceContainer,
    principal: Principal,
    scan_id: str,
    number: int,
    wanted: StageDecision,
    lease: int | None,
) -> ScanRow:
    """Store a person's decision on the points of interest of a stage and return the scan's row.

    Raises
    ------
    NotFound
        When there is no such scan, or it has no such stage.
    InvalidInput
        When a place is not over the aperture or beyond the records, or there is no such proposal.
    Conflict
        When the stage is decided or made already, or the scan has ended.
    """
    row = services.scans.get(scan_id)
    points = list(wanted.points_of_interest) or _proposed(row, number, wanted.proposals)
    _require_within_reach(services, row, points)
    stages = ScanStageRepository(services.scans.database, services.scans.clock)
    return stages.decide(
        scan_id,
        number,
        points,
        principal.name,
        lambda session, scan: require_lease(
            services, session, lease, principal, scan.scanner_id or services.scanner.id
        ),
    )


def _proposed(row: ScanRow, number: int, numbers: tuple[int, ...]) -> Points:
    """Return the places of proposals of a stage, by their numbers from 1."""
    stage = next((stage for stage in row.stages or () if stage["number"] == number), None)
    if stage is None:
        raise NotFound(f"stage of scan {row.id}", str(number))
    found = stage.get("proposals") or []
    for place, wanted in enumerate(numbers):
        if not 1 <= wanted <= len(found):
            raise InvalidInput(f"proposals[{place}]", wanted, f"1 to {len(found)}" if found else "none yet")
    return [tuple(found[wanted - 1]["position"]) for wanted in numbers]


def _require_within_reach(services: ServiceContainer, row: ScanRow, points: Points) -> None:
    """Raise ``InvalidInput`` for a place that is not over the aperture, or deeper than the records reach."""
    plan = services.plans.load(row.plan_id)
    half, deepest = plan.mask.aperture / 2, plan.recording_depth
    for number, (x, y, depth) in enumerate(points):
        if max(abs(x), abs(y)) > half:
            raise InvalidInput(
                f"points_of_interest[{number}]", f"({x:g}, {y:g})", f"over the aperture, ±{half:g} (m) on each axis"
            )
        if not 0 < depth < deepest:
            raise InvalidInput(
                f"points_of_interest[{number}]", f"a depth of {depth:g}", f"> 0 and less than {deepest:g} (m)"
            )
