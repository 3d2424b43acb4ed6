"""``/designs``: evaluation of a mask and plan without storing them."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from steradian.api.http.array_response import JSON
from steradian.api.http.client_disconnect import while_connected
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import ServicesDep
from steradian.api.routers.masks import check_point_limit
from steradian.api.routers.plans import PlanParameters
from steradian.api.schemas.reports import PreviewView
from steradian.api.schemas.resources import MaskPreviewView
from steradian.core.exceptions import InvalidInput
from steradian.core.json_encoding import nan_to_none
from steradian.core.quantity_ranges import SOUND_SPEED
from steradian.core.validation import Value, quantity_field
from steradian.masks import Arrangement, Mask
from steradian.storage.repositories.plans import plan_cost_document

router = APIRouter(prefix=f"{V1}/designs", tags=["designs"], route_class=AuthorizedRoute)

MOST_POINTS = 20_000
"""Largest mask whose point spread is worked out while somebody waits."""
_EQUI: dict[str, Any] = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 1600}
Across = Annotated[float, Field(ge=-1, le=1)]
Point = Annotated[
    tuple[Across, Across, Annotated[float, Field(gt=0, le=1)]] | None,
    Field(
        description="x, y, z of the evaluated position (m); none: the mask's first point of interest",
        examples=[[0, 0, 3.6e-3]],
    ),
]


class DesignRequest(PlanParameters):
    """Request to preview a mask and the plan of its measurement."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"arrangement": _EQUI, "pulse_rate": 1000}]})

    arrangement: Arrangement
    point: Point = None


class PointSpreadRequest(Value):
    """Request for the point spread of an unsaved mask: a small ball at one place."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"arrangement": _EQUI, "point": [1e-3, 0, 3.6e-3]}]})

    arrangement: Arrangement
    point: Point = None
    width: float = quantity_field("m", "Full width at half maximum of the ball", ge=1e-6, le=0.01, default=150e-6)
    sound_speed: float = quantity_field("m/s", "Speed of sound", default=1500.0, **SOUND_SPEED.limits)


class DesignView(BaseModel):
    """Preview of a mask and its plan."""

    mask: MaskPreviewView = Field(description="Metrics of the mask at the point; null without a point of interest")
    positions: list[list[float]] = Field(description="(M, 2) x, y on the film in metres, centred on the aperture")
    weights: list[float] = Field(description="(M,) areas in m², lengths in m for a line")
    outline: list[list[float]] | None = Field(description="Corners of the sensed area (m); null: not known")
    solid_angles: list[float] | None = Field(
        description="(M,) solid angle of each point's cell seen from the point (sr, rad for a line)"
    )
    visible_share: float | None = Field(description="Share of all orientations of edges that are visible there")
    visit: list[int] = Field(description="(M,) points in the order of interrogation")
    stages: list[int] = Field(
        description="Points of the mask, then the most of each further stage; one number for a scan of one stage"
    )
    plan: PreviewView = Field(description="Cost of the measurement")


class PointSpreadView(BaseModel):
    """Point spread: simulated image of a small ball, with its widths."""

    x: list[float] = Field(description="(Nx,) m")
    z: list[float] = Field(description="(Nz,) m")
    section: list[list[float]] = Field(description="(Nx, Nz) image in the plane y of the ball, its peak 1")
    lateral: float | None = Field(description="Full width at half maximum along x (m); null: cut off")
    axial: float | None = Field(description="Along z (m)")
    true_width: float = Field(description="Width of the ball itself (m)")
    background: float = Field(description="Root mean square beyond three widths, over the peak")


@router.post("/preview", summary="Preview of a mask with a plan", response_model=DesignView)
async def preview_design(services: ServicesDep, wanted: DesignRequest) -> Response:
    """Compute a mask's points, visit order, coverage and cost without storing anything."""
    check_point_limit(wanted.arrangement, services.settings.max_mask_points)
    return Response(await services.process_pool.submit(_look, wanted), media_type=JSON)


@router.post("/point-spread", summary="Simulated image of a small ball", response_model=PointSpreadView)
async def preview_point_spread(request: Request, services: ServicesDep, wanted: PointSpreadRequest) -> Response:
    """Simulate the point spread of an unsaved mask: A-lines of a small ball and their reconstruction.

    The computation ends when the client disconnects.
    """
    check_point_limit(wanted.arrangement, min(MOST_POINTS, services.settings.max_mask_points))
    body = await while_connected(request, services.process_pool.submit(_spread, wanted))
    return Response(body, media_type=JSON)


def _look(wanted: DesignRequest) -> bytes:
    from steradian.masks.limited_view import visible_fraction
    from steradian.masks.metrics import evaluate_mask

    plan = wanted.plan(_mask(wanted.arrangement))
    mask = plan.mask  # with several beams another, and in stages the survey
    seen = evaluate_mask(mask, wanted.point)
    place, angles = seen.point_of_interest, seen.solid_angles
    return (
        DesignView(
            mask=MaskPreviewView.of(mask, seen),
            positions=mask.film_positions.tolist(),
            weights=mask.weights.tolist(),
            outline=None if mask.outline is None else mask.outline.tolist(),
            solid_angles=None if angles is None else angles.tolist(),
            visible_share=None if place is None else visible_fraction(mask, place),
            visit=plan.visit.tolist(),
            stages=[mask.count, *(stage.points for stage in plan.stages)],
            plan=PreviewView.model_validate(plan_cost_document(plan)),
        )
        .model_dump_json()
        .encode()
    )


def _spread(wanted: PointSpreadRequest) -> bytes:
    from steradian.masks.point_spread import point_spread

    mask = _mask(wanted.arrangement)
    found = point_spread(mask, wanted.point, width=wanted.width, sound_speed=wanted.sound_speed)
    view: dict[str, Any] = {name: getattr(found, name) for name in ("true_width", "background")}
    view |= {name: getattr(found, name).tolist() for name in ("x", "z", "section")}
    view |= dict(zip(("lateral", "axial"), nan_to_none([found.lateral, found.axial]), strict=True))
    return PointSpreadView(**view).model_dump_json().encode()


def _mask(arrangement: Arrangement) -> Mask:
    """Build a mask; errors name fields below ``arrangement``, as in the request."""
    try:
        return arrangement.build()
    except InvalidInput as error:
        raise InvalidInput(f"arrangement.{error.field}", error.value, error.allowed) from error
