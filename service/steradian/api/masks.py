"""``/masks``: where to sense."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Body, Request, Response

from steradian.api.dependencies import Before, Limit, ServicesNeeded, link_next
from steradian.api.views import Listing, MaskView, PointsView
from steradian.errors import InvalidInput
from steradian.masks import Arrangement

router = APIRouter(prefix="/masks", tags=["masks"])

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
def create_mask(
    services: ServicesNeeded,
    response: Response,
    arrangement: Annotated[Arrangement, Body(openapi_examples=_EXAMPLES)],
) -> MaskView:
    """Keep a mask; the same parameters always give the same id."""
    _check_size(arrangement, services.settings.max_mask_points)
    row, is_new = services.masks.put(arrangement.build())
    view = MaskView.of(row)
    response.status_code = 201 if is_new else 200
    response.headers["Location"] = view.links["self"]
    return view


@router.get("", summary="Masks, newest first")
def list_masks(
    services: ServicesNeeded, request: Request, response: Response, limit: Limit = 100, before: Before = None
) -> Listing[MaskView]:
    """List masks."""
    page = services.masks.page(limit, before)
    link_next(response, request, limit, page.cursor)
    return Listing(items=[MaskView.of(row) for row in page.rows])


@router.get("/{mask_id}", summary="One mask")
def read_mask(services: ServicesNeeded, mask_id: str) -> MaskView:
    """Show a mask without its points."""
    return MaskView.of(services.masks.get(mask_id))


@router.get("/{mask_id}/points", summary="Positions and weights of a mask")
def read_points(services: ServicesNeeded, mask_id: str) -> PointsView:
    """Show the points of a mask."""
    mask = services.masks.load(mask_id)
    return PointsView(id=mask.id, count=mask.count, positions=mask.positions.tolist(), weights=mask.weights.tolist())


def _check_size(arrangement: Arrangement, limit: int) -> None:
    """Refuse a mask that is too large before it is built."""
    expected = arrangement.expected_count
    if expected > limit:
        decisive = ("count", "positions", "indices", "points_of_interest", "spacing", "interval")
        field = next((name for name in decisive if name in type(arrangement).model_fields), "arrangement")
        raise InvalidInput(field, f"worth {expected} points", f"at most {limit} points in all")
