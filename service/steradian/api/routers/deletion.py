"""DELETE of masks, plans, scans, reconstructions, jobs and batches."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Final

from fastapi import APIRouter, Query, Response

from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import CurrentPrincipal, ServicesDep
from steradian.api.params.path import BATCH_ID, JOB_ID, MASK_ID, PLAN_ID, RECONSTRUCTION_ID, SCAN_ID
from steradian.api.services import ServiceContainer
from steradian.security.keys import Forbidden, Principal, Scope

router = APIRouter(prefix=V1, route_class=AuthorizedRoute)
REQUIRED_SCOPES: Final = {
    "mask": Scope.PLAN,
    "plan": Scope.PLAN,
    "scan": Scope.OPERATE,
    "batch": Scope.RECONSTRUCT,
    "reconstruction": Scope.RECONSTRUCT,
    "job": Scope.RECONSTRUCT,
}
"""What a key must allow to delete a thing of each kind, also where it goes with another one."""
Dependents = Annotated[
    bool, Query(description="Also delete all dependent resources; otherwise a 409 has-dependents lists them")
]
DELETED_RESPONSE: dict[str, Any] = {"status_code": 204, "response_class": Response}


@router.delete("/masks/{mask_id}", summary="Delete a mask", tags=["masks"], **DELETED_RESPONSE)
def delete_mask(
    services: ServicesDep, who: CurrentPrincipal, mask_id: MASK_ID, dependents: Dependents = False
) -> Response:
    """Delete a mask; its plans depend on it, and the what-if reconstructions through it."""
    return _delete(services, who, "mask", mask_id, dependents)


@router.delete("/plans/{plan_id}", summary="Delete a plan", tags=["plans"], **DELETED_RESPONSE)
def delete_plan(
    services: ServicesDep, who: CurrentPrincipal, plan_id: PLAN_ID, dependents: Dependents = False
) -> Response:
    """Delete a plan; its scans depend on it."""
    return _delete(services, who, "plan", plan_id, dependents)


@router.delete("/scans/{scan_id}", summary="Delete a scan with its A-lines", tags=["scans"], **DELETED_RESPONSE)
def delete_scan(
    services: ServicesDep, who: CurrentPrincipal, scan_id: SCAN_ID, dependents: Dependents = False
) -> Response:
    """Delete a finished or interrupted scan; its jobs and batches depend on it."""
    return _delete(services, who, "scan", scan_id, dependents)


@router.delete("/batches/{batch_id}", summary="Delete a batch", tags=["batches"], **DELETED_RESPONSE)
def delete_batch(
    services: ServicesDep, who: CurrentPrincipal, batch_id: BATCH_ID, dependents: Dependents = False
) -> Response:
    """Delete a batch; its reconstructions depend on it."""
    return _delete(services, who, "batch", batch_id, dependents)


@router.delete(
    "/reconstructions/{reconstruction_id}", summary="Delete a volume", tags=["reconstructions"], **DELETED_RESPONSE
)
def delete_reconstruction(
    services: ServicesDep, who: CurrentPrincipal, reconstruction_id: RECONSTRUCTION_ID, dependents: Dependents = False
) -> Response:
    """Delete a finished reconstruction with all its files; comparisons and exports of it depend on it."""
    return _delete(services, who, "reconstruction", reconstruction_id, dependents)


@router.delete("/jobs/{job_id}", summary="Delete a job and its files", tags=["jobs"], **DELETED_RESPONSE)
def delete_job(
    services: ServicesDep, who: CurrentPrincipal, job_id: JOB_ID, dependents: Dependents = False
) -> Response:
    """Delete a finished job with all its files; for a reconstruction, the same as DELETE /reconstructions/{id}."""
    return _delete(services, who, "job", job_id, dependents)


def _delete(services: ServiceContainer, who: Principal, kind: str, identifier: str, dependents: bool) -> Response:
    def check(kinds: Iterable[str]) -> None:
        if missing := sorted({str(REQUIRED_SCOPES[kind]) for kind in kinds if not who.may(REQUIRED_SCOPES[kind])}):
            raise Forbidden(f"to delete this with all that depends on it a key needs the scope {' and '.join(missing)}")

    services.deletion.delete(kind, identifier, who.name, dependents=dependents, check=check)
    services.remove_files()
    return Response(status_code=204)
