"""``/reconstructions/{id}/quality``: similarity of a reconstruction to reference reconstructions."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import BaseModel, ConfigDict, Field

from steradian.api.http.urls import link
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import CurrentPrincipal, OptionalIdempotencyKey, ServicesDep, Wait
from steradian.api.params.path import RECONSTRUCTION_ID
from steradian.api.routers.jobs import submitted_job_response
from steradian.api.schemas.jobs import JobView
from steradian.api.schemas.resources import BASE, Listing
from steradian.core.validation import Value
from steradian.jobs.request_base import Identifier
from steradian.jobs.requests import QualityRequest
from steradian.storage.repositories import filters
from steradian.storage.state_machines import ReconstructionState

router = APIRouter(prefix=f"{V1}/reconstructions", tags=["reconstructions"], route_class=AuthorizedRoute)
MAX_COMPARISONS = 200


class Reference(Value):
    """Request to compare with a reference reconstruction."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"reference_id": "r01jz0000000000000000000001"}]})

    reference_id: Identifier = Field(description="Identifier of a reconstruction of the same voxels")
    index: int | None = QualityRequest.model_fields["index"]  # type: ignore[assignment]
    reference_index: int | None = QualityRequest.model_fields["reference_index"]  # type: ignore[assignment]
    diameter: float | None = QualityRequest.model_fields["diameter"]  # type: ignore[assignment]
    threshold: float = QualityRequest.model_fields["threshold"]  # type: ignore[assignment]


class QualityView(BaseModel):
    """Result of comparing a reconstruction with a reference reconstruction."""

    reference_id: str
    index: int | None = Field(default=None, description="Which volume of a series was judged")
    reference_index: int | None = Field(default=None, description="Which volume of a series was the reference")
    diameter: float | None = Field(description="Of the disc that counted (m)")
    threshold: float
    state: ReconstructionState
    figures: dict[str, float | None] | None = Field(
        description="Correlations, sharpness and error, when it has succeeded", examples=[{"volume_correlation": 0.48}]
    )
    links: dict[str, str] = Field(examples=[{"job": f"{BASE}/jobs/…"}])


@router.post(
    "/{reconstruction_id}/quality",
    status_code=202,
    summary="Compare a reconstruction with another one",
    response_model=JobView,
    responses={201: {"model": JobView, "description": "It was over within the time waited for"}},
)
async def create_reconstruction_quality(
    services: ServicesDep,
    who: CurrentPrincipal,
    reconstruction_id: RECONSTRUCTION_ID,
    wanted: Reference,
    key: OptionalIdempotencyKey,
    wait: Wait,
) -> Response:
    """Queue a comparison with a reference reconstruction and return its job."""
    await run_in_threadpool(services.ledger.reconstruction, reconstruction_id)
    request = QualityRequest.create(reconstruction_id=reconstruction_id, **wanted.model_dump())
    return await submitted_job_response(services, who, request, key, wait)


@router.get("/{reconstruction_id}/quality", summary="Comparisons of a reconstruction")
def list_reconstruction_quality(services: ServicesDep, reconstruction_id: RECONSTRUCTION_ID) -> Listing[QualityView]:
    """List the comparisons of a reconstruction, newest first."""
    services.ledger.reconstruction(reconstruction_id)
    page = services.ledger.page(
        MAX_COMPARISONS, None, filters.jobs(kind="quality", reconstruction_id=reconstruction_id)
    )
    return Listing(
        items=[
            QualityView(
                **{name: row.payload[name] for name in ("reference_id", "diameter", "threshold")},
                index=row.payload.get("index"),
                reference_index=row.payload.get("reference_index"),
                state=row.state,
                figures=_figures(row.result),
                links={
                    "job": link(f"/jobs/{row.id}"),
                    "reference": link(f"/reconstructions/{row.payload['reference_id']}"),
                },
            )
            for row in page.rows
        ]
    )


def _figures(result: dict[str, Any] | None) -> dict[str, float | None] | None:
    return None if result is None else result.get("figures")
