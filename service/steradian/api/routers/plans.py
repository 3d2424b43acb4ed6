"""``/plans``: create, preview, list and read scan plans."""

from __future__ import annotations

from typing import Any, Literal

from fastapi import APIRouter, Request, Response
from pydantic import ConfigDict, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.http.array_response import JSON, PICTURE, PNG, negotiate
from steradian.api.http.conditional import ReadPreconditionsDep, resource_etag
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import Limit, PageCursor, ServicesDep, set_next_link
from steradian.api.params.filters import MaskIdFilter
from steradian.api.params.path import PLAN_ID
from steradian.api.schemas.reports import PreviewView
from steradian.api.schemas.resources import Listing, PlanView
from steradian.api.services import ServiceContainer
from steradian.core.exceptions import InvalidInput
from steradian.core.validation import FloatArray, Value
from steradian.masks import Mask, multi_beam_mask
from steradian.plans import Fringe, Link, Motion, ScannerLimits, ScanPlan, Tuning, TuningMap, VisitOrder
from steradian.plans.stages import FEWEST_POINTS, FocusRule, FocusStage, StoppingRule
from steradian.storage.repositories import filters
from steradian.storage.repositories.masks import mask_row_values as mask_columns
from steradian.storage.repositories.plans import to_columns

router = APIRouter(prefix=f"{V1}/plans", tags=["plans"], route_class=AuthorizedRoute)

OPTIMISED_ORDERS = frozenset({VisitOrder.SHORTEST, VisitOrder.WAVELENGTH, VisitOrder.BANDS, VisitOrder.PROGRESSIVE})
"""Orders that take seconds and compiled code; the others are told in milliseconds."""


def _mirror_field(name: str) -> Any:
    """Return the field definition of :class:`ScanPlan` (limits, default, unit) for the same field of a request."""
    return ScanPlan.model_fields[name]


class SurveyRequest(FocusRule):
    """Survey of a plan in stages: its points, and the rule for the points of interest of the focus."""

    points: int = Field(default=200, ge=16, le=1_000_000, description="Points of the survey, out of the mask's number")

    def apply(self, plan: ScanPlan) -> ScanPlan:
        """Return the plan in stages with no more points than ``plan``; raises :class:`InvalidInput`."""
        from steradian.plans.next_stage import plan_in_stages

        rule = self.model_dump(exclude={"points"}) | {"points": FEWEST_POINTS}
        return plan_in_stages(plan, self.points, focus=FocusStage.create(**rule), stopping=plan.stopping)


class PlanParameters(Value):
    """Scan parameters of a plan request."""

    pulse_rate: float = _mirror_field("pulse_rate")
    averages: int = _mirror_field("averages")
    samples: int = _mirror_field("samples")
    sampling_interval: float = _mirror_field("sampling_interval")
    sound_speed: float = _mirror_field("sound_speed")
    order: VisitOrder = VisitOrder.SNAKE
    wavelengths: FloatArray | None = _mirror_field("wavelengths")
    tuning_map: TuningMap | None = Field(
        default=None, description="Where which wavelength is best, to be interpolated; in place of wavelengths"
    )
    wavelength_uncertainty: float = _mirror_field("wavelength_uncertainty")
    max_sensitivity_loss: float = _mirror_field("max_sensitivity_loss")
    fringe: Fringe = Fringe()
    beams: tuple[tuple[float, float], ...] = _mirror_field("beams")
    places: int | None = Field(
        default=None, ge=1, description="Places the beams are brought to; none: the mask's points over the beams"
    )
    frames: int = _mirror_field("frames")
    excitation: tuple[float, ...] = _mirror_field("excitation")
    survey: SurveyRequest | None = Field(
        default=None, description="Measure in stages: first a survey of the aperture, then a focus; null: one stage"
    )
    stopping: StoppingRule | None = _mirror_field("stopping")
    gate: Literal["none", "frame", "point"] = _mirror_field("gate")
    gate_rate: float = _mirror_field("gate_rate")
    scanner: ScannerLimits = ScannerLimits()
    motion: Motion = Motion()
    tuning: Tuning = Tuning()
    link: Link = Link()

    def plan(self, mask: Mask) -> ScanPlan:
        """Create the scan plan of a mask with these parameters; raises :class:`InvalidInput`."""
        own = ("tuning_map", "places", "survey", "stopping")
        fields = {name: getattr(self, name) for name in PlanParameters.model_fields if name not in own}
        if self.beams:
            if self.wavelengths is not None:
                raise InvalidInput(
                    "wavelengths", f"{self.wavelengths.size} of them", "a tuning_map, with several beams"
                )
            mask = multi_beam_mask(mask, self.beams, places=self.places)
        if self.tuning_map is not None:
            if self.wavelengths is not None:
                raise InvalidInput("wavelengths", f"{self.wavelengths.size} of them", "none beside tuning_map")
            fields |= self.tuning_map.as_plan_fields(mask)
        plan = ScanPlan.create(mask=mask, stopping=self.stopping, **fields)
        return plan if self.survey is None else self.survey.apply(plan)


class PlanRequest(PlanParameters):
    """Request for a plan: a mask and its scan parameters."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"mask_id": "m0123456789abcdef01234567", "pulse_rate": 50},
                {"mask_id": "m0123456789abcdef01234567", "frames": 2, "excitation": [7.5e-7, 8.5e-7]},
            ]
        }
    )

    mask_id: str = Field(min_length=1, max_length=64, description="Identifier of the mask")


@router.post(
    "",
    status_code=201,
    summary="Make a plan from a mask",
    responses={200: {"model": PlanView, "description": "The same plan exists already"}},
)
async def create_plan(services: ServicesDep, response: Response, wanted: PlanRequest) -> PlanView:
    """Store a plan; the same body always gives the same id.

    With several ``beams`` the plan's mask is another one, which is kept, too: the points that the beams measure. With a
    ``survey`` it is the mask of the survey.
    """
    columns, covered = await _compute_rows(services, wanted)
    if covered is not None:
        await run_in_threadpool(services.masks.insert_row, covered)
    row, is_new = await run_in_threadpool(services.plans.put_columns, columns)
    view = PlanView.of(row)
    response.status_code = 201 if is_new else 200
    response.headers["Location"] = view.links["self"]
    return view


@router.post(
    "/preview",
    summary="Preview of a plan's cost",
    response_model=PreviewView,
    responses={200: {"description": "Nothing is stored", "content": PICTURE}},
)
async def preview_plan(services: ServicesDep, request: Request, wanted: PlanRequest) -> Response:
    """Compute time, bytes and findings of a plan, or draw the path of its beam, without storing anything."""
    body: bytes | str
    if (kind := negotiate(request, (JSON, PNG))) == PNG:
        mask = await run_in_threadpool(services.masks.load, wanted.mask_id)
        async with services.previewing:
            body = await services.process_pool.submit(_picture, mask, wanted)
    else:
        body = PreviewView.model_validate((await _compute_rows(services, wanted))[0]["preview"]).model_dump_json()
    return Response(body, media_type=kind, headers={"Vary": "Accept"})


@router.get("", summary="Plans, newest first")
def list_plans(
    services: ServicesDep,
    request: Request,
    response: Response,
    mask_id: MaskIdFilter = None,
    limit: Limit = 100,
    before: PageCursor = None,
) -> Listing[PlanView]:
    """List plans."""
    page = services.plans.page(limit, before, filters.plans(mask_id=mask_id))
    set_next_link(response, request, limit, page.cursor)
    return Listing(items=[PlanView.of(row) for row in page.rows])


@router.get("/{plan_id}", summary="One plan")
def read_plan(services: ServicesDep, plan_id: PLAN_ID, conditions: ReadPreconditionsDep) -> PlanView:
    """Return a plan with its cost."""
    row = services.plans.get(plan_id)
    conditions.tag(resource_etag(row.id, 1))
    return PlanView.of(row)


async def _compute_rows(
    services: ServiceContainer, wanted: PlanRequest
) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Return the database columns of a plan, and those of its mask if the mask is new.

    Long computations run in the process pool.
    """
    if wanted.order in OPTIMISED_ORDERS or wanted.beams or wanted.survey is not None:
        mask = await run_in_threadpool(services.masks.load, wanted.mask_id)
        return await services.process_pool.submit(_build, mask, wanted)
    return await run_in_threadpool(lambda: _build(services.masks.load(wanted.mask_id), wanted))


def _build(mask: Mask, wanted: PlanRequest) -> tuple[dict[str, Any], dict[str, Any] | None]:
    plan = wanted.plan(mask)
    return to_columns(plan), mask_columns(plan.mask) if plan.beams or plan.stages else None


def _picture(mask: Mask, wanted: PlanRequest) -> bytes:
    from steradian.drawing.mpl_style import to_png
    from steradian.plans.plots import plan_figure

    return to_png(plan_figure(wanted.plan(mask)))
