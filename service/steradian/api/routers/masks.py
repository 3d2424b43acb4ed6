"""``/masks``: create, preview, list and read masks."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Body, Request, Response
from starlette.concurrency import run_in_threadpool

from steradian.api.http.array_response import CSV, JSON, NPY, PICTURE, PNG, negotiate
from steradian.api.http.conditional import ReadPreconditionsDep, resource_etag
from steradian.api.http.file_response import RANGED, RangeFileResponse
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import Limit, PageCursor, ServicesDep, set_next_link
from steradian.api.params.filters import ArrangementFilter
from steradian.api.params.path import MASK_ID
from steradian.api.schemas.resources import Listing, MaskPreviewView, MaskView, PointsView
from steradian.core.exceptions import InvalidInput
from steradian.masks import Arrangement, Mask
from steradian.storage.repositories import filters
from steradian.storage.repositories.masks import mask_row_values

router = APIRouter(prefix=f"{V1}/masks", tags=["masks"], route_class=AuthorizedRoute)

SMALL = 2_000
"""Points up to which a mask is made by the API's own process."""
_EXAMPLES = {
    "equi-steradian": {
        "value": {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 1600}
    },
    "grid": {"value": {"arrangement": "grid", "aperture": 13.56e-3, "count": 41, "interval": 300e-6}},
    "points": {"value": {"arrangement": "points", "aperture": 0.01, "positions": [[0, 0], [1e-3, 0]]}},
}


@router.post(
    "",
    status_code=201,
    summary="Make a mask from the parameters of an arrangement",
    responses={200: {"model": MaskView, "description": "The same mask exists already"}},
)
async def create_mask(
    services: ServicesDep,
    response: Response,
    arrangement: Annotated[Arrangement, Body(openapi_examples=_EXAMPLES)],
) -> MaskView:
    """Store a mask; the same parameters always give the same id."""
    check_point_limit(arrangement, services.settings.max_mask_points)
    if arrangement.expected_count > SMALL:
        columns = await services.process_pool.submit(_build, arrangement)
    else:
        columns = await run_in_threadpool(_build, arrangement)
    row, is_new = await run_in_threadpool(services.masks.insert_row, columns)
    view = MaskView.of(row)
    response.status_code = 201 if is_new else 200
    response.headers["Location"] = view.links["self"]
    return view


@router.post(
    "/preview",
    summary="Preview of a mask and its metrics",
    response_model=MaskPreviewView,
    responses={200: {"description": "Nothing is stored", "content": PICTURE}},
)
async def preview_mask(
    services: ServicesDep,
    request: Request,
    arrangement: Annotated[Arrangement, Body(openapi_examples=_EXAMPLES)],
) -> Response:
    """Compute the points and metrics of a mask, or draw the mask, without storing anything."""
    kind = negotiate(request, (JSON, PNG))
    check_point_limit(arrangement, services.settings.max_mask_points)
    if kind == PNG:
        async with services.previewing:
            body = await services.process_pool.submit(_picture, arrangement)
    else:
        body = await services.process_pool.submit(_mask_metrics, arrangement)
    return Response(body, media_type=kind, headers={"Vary": "Accept"})


@router.get("", summary="Masks, newest first")
def list_masks(
    services: ServicesDep,
    request: Request,
    response: Response,
    arrangement: ArrangementFilter = None,
    limit: Limit = 100,
    before: PageCursor = None,
) -> Listing[MaskView]:
    """List masks."""
    page = services.masks.page(limit, before, filters.masks(arrangement=arrangement))
    set_next_link(response, request, limit, page.cursor)
    return Listing(items=[MaskView.of(row) for row in page.rows])


@router.get("/{mask_id}", summary="One mask")
def read_mask(services: ServicesDep, mask_id: MASK_ID, conditions: ReadPreconditionsDep) -> MaskView:
    """Return a mask without its points."""
    row = services.masks.get(mask_id)
    conditions.tag(resource_etag(row.id, 1))
    return MaskView.of(row)


@router.get(
    "/{mask_id}/points",
    summary="Positions and weights of a mask",
    response_model=PointsView,
    responses={
        200: {"content": {CSV: {"schema": {"type": "string"}}, NPY: {"schema": {"type": "string", "format": "binary"}}}}
    },
)
def read_mask_points(
    services: ServicesDep, request: Request, mask_id: MASK_ID, conditions: ReadPreconditionsDep
) -> Response:
    """Return the points as JSON, as CSV (x, y, weight) or as an npy array (count, 3) of x, y and weight."""
    kind = negotiate(request, (JSON, CSV, NPY))
    row = services.masks.get(mask_id)
    etag = resource_etag(row.id, kind.rpartition("/")[2])
    conditions.tag(etag, vary="Accept")
    body = _render_points(services.masks.load(mask_id), kind)
    return Response(body, media_type=kind, headers={"ETag": etag, "Vary": "Accept"})


@router.get(
    "/{mask_id}/picture",
    summary="A picture of a mask",
    response_class=RangeFileResponse,
    openapi_extra=RANGED,
    responses={200: {"content": PICTURE}},
)
async def read_mask_picture(
    services: ServicesDep, mask_id: MASK_ID, conditions: ReadPreconditionsDep
) -> RangeFileResponse:
    """Return a picture of the mask: points, density and coverage. It is drawn once and cached."""
    await run_in_threadpool(services.masks.get, mask_id)
    etag = resource_etag(mask_id, "picture")
    conditions.tag(etag)
    path = services.data.picture(mask_id)
    if not await run_in_threadpool(path.is_file):
        async with services.drawing:
            if not await run_in_threadpool(path.is_file):
                await services.process_pool.submit(_draw, await run_in_threadpool(services.masks.load, mask_id), path)
    return RangeFileResponse(path, media_type=PNG, headers={"ETag": etag})


def _build(arrangement: Arrangement) -> dict[str, Any]:
    return mask_row_values(arrangement.build())


def _mask_metrics(arrangement: Arrangement) -> bytes:
    from steradian.masks.metrics import evaluate_mask

    mask = arrangement.build()
    return MaskPreviewView.of(mask, evaluate_mask(mask)).model_dump_json().encode()


def _picture(arrangement: Arrangement) -> bytes:
    from steradian.drawing.mpl_style import to_png
    from steradian.masks.plots import mask_figure

    return to_png(mask_figure(arrangement.build(), with_point_spread=False))


def _draw(mask: Mask, path: Path) -> None:
    from steradian.masks.plots import draw_mask  # the API's own process draws nothing

    draw_mask(mask, path, with_point_spread=False)


def _render_points(mask: Mask, kind: str) -> bytes | str:
    table = np.column_stack([mask.positions, mask.weights])
    if kind == NPY:
        array = io.BytesIO()
        np.save(array, table)
        return array.getvalue()
    if kind == CSV:
        text = io.StringIO()
        writer = csv.writer(text)
        writer.writerow(["x_m", "y_m", "weight_m2"])
        writer.writerows(table.tolist())
        return text.getvalue()
    return PointsView(
        id=mask.id,
        count=mask.count,
        positions=mask.positions.tolist(),
        weights=mask.weights.tolist(),
        sensed_area=mask.sensed_area,
        outline=None if mask.outline is None else mask.outline.tolist(),
    ).model_dump_json()


def check_point_limit(arrangement: Arrangement, limit: int) -> None:
    """Reject an arrangement whose expected number of points exceeds the limit; raises :class:`InvalidInput`."""
    expected = arrangement.expected_count
    if expected > limit:
        decisive = ("count", "positions", "indices", "points_of_interest", "spacing", "interval")
        field = next((name for name in decisive if name in type(arrangement).model_fields), "arrangement")
        raise InvalidInput(field, f"worth {expected} points", f"at most {limit} points in all")
