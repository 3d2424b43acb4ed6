"""``/plans``: create, preview, list and read scan plans."""

from __future__ import annotations

from typing import Any, Literal

from fastapi import APIRouter, Request, Response
from pydantic import ConfigDict, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.http.array_response import JSON, PICTURE, PNG, negotiate
from steradian.api.http.conditional import ConditionsNeeded, etag_of
from steradian.api.middleware.authentication import V1, GuardedRoute
from steradian.api.params.dependencies import Before, Limit, ServicesNeeded, link_next
from steradian.api.params.filters import OfMask
from steradian.api.params.path import PLAN_ID
from steradian.api.schemas.reports import PreviewView
from steradian.api.schemas.resources import Listing, PlanView
from steradian.api.services import Services
from steradian.core.exceptions import InvalidInput
from steradian.core.validation import FloatArray, Value
from steradian.masks import Mask, beams_mask
from steradian.plans import Fringe, Link, Motion, ScannerLimits, ScanPlan, Tuning, TuningMap, VisitOrder
from steradian.storage.repositories import filters
from steradian.storage.repositories.masks import to_columns as mask_columns
from steradian.storage.repositories.plans import to_columns

router = APIRouter(prefix=f"{V1}/plans", tags=["plans"], route_class=GuardedRoute)

SEARCHED = frozenset({VisitOrder.SHORTEST, VisitOrder.WAVELENGTH, VisitOrder.BANDS, VisitOrder.PROGRESSIVE})
"""Orders that take seconds and compiled code; the others are told in milliseconds."""


def _same_as(name: str) -> Any:
    """Declare a field with the limits, default and unit that the plan itself has."""
    return ScanPlan.model_fields[name]


class Measuring(Value):
    """Scan parameters of a plan request."""

    pulse_rate: float = _same_as("pulse_rate")
    averages: int = _same_as("averages")
    samples: int = _same_as("samples")
    sampling_interval: float = _same_as("sampling_interval")
    sound_speed: float = _same_as("sound_speed")
    order: VisitOrder = VisitOrder.SNAKE
    wavelengths: FloatArray | None = _same_as("wavelengths")
    tuning_map: TuningMap | None = Field(
        default=None, description="Where which wavelength is best, to be interpolated; in place of wavelengths"
    )
    wavelength_uncertainty: float = _same_as("wavelength_uncertainty")
    max_sensitivity_loss: float = _same_as("max_sensitivity_loss")
    fringe: Fringe = Fringe()
    beams: tuple[tuple[float, float], ...] = _same_as("beams")
    places: int | None = Field(
        default=None, ge=1, description="Places the beams are brought to; none: the mask's points over the beams"
    )
    frames: int = _same_as("frames")
    excitation: tuple[float, ...] = _same_as("excitation")
    gate: Literal["none", "frame", "point"] = _same_as("gate")
    gate_rate: float = _same_as("gate_rate")
    scanner: ScannerLimits = ScannerLimits()
    motion: Motion = Motion()
    tuning: Tuning = Tuning()
    link: Link = Link()

    def plan(self, mask: Mask) -> ScanPlan:
        """Make the plan that measures a mask so; raises :class:`InvalidInput`."""
        fields = {name: getattr(self, name) for name in Measuring.model_fields if name not in ("tuning_map", "places")}
        if self.beams:
            if self.wavelengths is not None:
                raise InvalidInput(
                    "wavelengths", f"{self.wavelengths.size} of them", "a tuning_map, with several beams"
                )
            mask = beams_mask(mask, self.beams, places=self.places)
        if self.tuning_map is not None:
            if self.wavelengths is not None:
                raise InvalidInput("wavelengths", f"{self.wavelengths.size} of them", "none beside tuning_map")
            fields |= self.tuning_map.fields(mask)
        return ScanPlan.create(mask=mask, **fields)


class PlanRequest(Measuring):
    """A plan: a mask and how to measure it."""

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
async def create_plan(services: ServicesNeeded, response: Response, wanted: PlanRequest) -> PlanView:
    """Keep a plan; the same body always gives the same id.

    With several ``beams`` the plan's mask is another one, which is kept, too: the points that the beams measure.
    """
    columns, covered = await _worked_out(services, wanted)
    if covered is not None:
        await run_in_threadpool(services.masks.put_columns, covered)
    row, is_new = await run_in_threadpool(services.plans.put_columns, columns)
    view = PlanView.of(row)
    response.status_code = 201 if is_new else 200
    response.headers["Location"] = view.links["self"]
    return view


@router.post(
    "/preview",
    summary="What a plan would cost",
    response_model=PreviewView,
    responses={200: {"description": "Nothing is stored", "content": PICTURE}},
)
async def preview_plan(services: ServicesNeeded, request: Request, wanted: PlanRequest) -> Response:
    """Work out time, bytes and findings of a plan, or draw its way over the mask, storing nothing."""
    body: bytes | str
    if (kind := negotiate(request, (JSON, PNG))) == PNG:
        mask = await run_in_threadpool(services.masks.load, wanted.mask_id)
        async with services.previewing:
            body = await services.workshop.work(_picture, mask, wanted)
    else:
        body = PreviewView.model_validate((await _worked_out(services, wanted))[0]["preview"]).model_dump_json()
    return Response(body, media_type=kind, headers={"Vary": "Accept"})


@router.get("", summary="Plans, newest first")
def list_plans(
    services: ServicesNeeded,
    request: Request,
    response: Response,
    mask_id: OfMask = None,
    limit: Limit = 100,
    before: Before = None,
) -> Listing[PlanView]:
    """List plans."""
    page = services.plans.page(limit, before, filters.plans(mask_id=mask_id))
    link_next(response, request, limit, page.cursor)
    return Listing(items=[PlanView.of(row) for row in page.rows])


@router.get("/{plan_id}", summary="One plan")
def read_plan(services: ServicesNeeded, plan_id: PLAN_ID, conditions: ConditionsNeeded) -> PlanView:
    """Show a plan."""
    row = services.plans.get(plan_id)
    conditions.tag(etag_of(row.id, 1))
    return PlanView.of(row)


async def _worked_out(services: Services, wanted: PlanRequest) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Return the columns of a plan's row, and of its mask's if that is new.

    Long computations run in the process pool.
    """
    if wanted.order in SEARCHED or wanted.beams:
        mask = await run_in_threadpool(services.masks.load, wanted.mask_id)
        return await services.workshop.work(_build, mask, wanted)
    return await run_in_threadpool(lambda: _build(services.masks.load(wanted.mask_id), wanted))


def _build(mask: Mask, wanted: PlanRequest) -> tuple[dict[str, Any], dict[str, Any] | None]:
    plan = wanted.plan(mask)
    return to_columns(plan), mask_columns(plan.mask) if plan.beams else None


def _picture(mask: Mask, wanted: PlanRequest) -> bytes:
    from steradian.drawing.painting import paint
    from steradian.plans.picture import plan_page

    return paint(plan_page(wanted.plan(mask))).png()
