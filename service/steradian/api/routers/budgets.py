"""``/designs/budget``: points × averages for a number of laser pulses and a vessel."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.http.array_response import JSON
from steradian.api.http.client_disconnect import while_connected
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import ServicesDep
from steradian.api.routers.scan_data import file_of
from steradian.api.services import ServiceContainer
from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import SAMPLING_INTERVAL, SOUND_SPEED
from steradian.core.validation import Value, quantity_field
from steradian.masks import Counted

router = APIRouter(prefix=f"{V1}/designs", tags=["designs"], route_class=AuthorizedRoute)

MOST_POINTS, MOST_MODES = 12_000, 256
"""Points of a split and modes of an image that are simulated while somebody waits."""
VOXEL = 60e-6
Averages = Annotated[int, Field(ge=1, le=65_535)]
Across = Annotated[float, Field(ge=-0.05, le=0.05)]
MOST_ITERATIVE = 2
"""Splits of one request that are imaged iteratively; each takes about half a minute of processor time."""
FIELDS = {"time": "duration", "pulses": "duration", "samples": "sampling_interval", "traces": "scan_id"}
"""Fields of the request by the library's names."""


class BudgetRequest(Value):
    """Request to split the pulses of a laser between points and averages, for one arrangement and method."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"duration": 900, "pulse_rate": 50, "aperture": 0.01, "depth": 0.0025, "vessel": 1.5e-4, "noise": 10}
            ]
        }
    )

    arrangement: Counted = "equi-steradian"
    method: Literal["direct", "iterative"] = Field(
        default="direct", description="Method of reconstruction; iterative only for one or two given averages"
    )
    duration: float = quantity_field("s", "Time of the scan", gt=0, le=1e6)
    pulse_rate: float = quantity_field("Hz", "Laser pulses per second", ge=0.1, le=10_000, default=50.0)
    aperture: float = quantity_field("m", "Side of the square aperture", ge=1e-3, le=0.05, default=13.56e-3)
    depth: float = quantity_field("m", "Distance of the vessel from the film", ge=2e-4, le=0.05)
    offset: tuple[Across, Across] = Field(default=(0.0, 0.0), description="x and y of the vessel (m)")
    vessel: float = quantity_field("m", "Diameter of the vessel", ge=1e-5, le=2e-3)
    noise: Annotated[float, Field(ge=-60, le=120)] | None = Field(
        default=None, description="Peak of the strongest A-line over the noise of one pulse (dB); null: from a scan"
    )
    scan_id: Annotated[str, Field(min_length=1, max_length=64)] | None = Field(
        default=None, description="Scan of a similar object in which the noise of one pulse is measured"
    )
    averages: Annotated[tuple[Averages, ...], Field(min_length=1, max_length=8)] | None = Field(
        default=None, description="Averages to try; null: about powers of two"
    )
    sampling_interval: float = quantity_field("s", "Time between samples", default=8e-9, **SAMPLING_INTERVAL.limits)
    sound_speed: float = quantity_field("m/s", "Speed of sound", default=1500.0, **SOUND_SPEED.limits)


class SplitView(BaseModel):
    """Split of the pulses with the expected image of the vessel."""

    points: int
    averages: int
    seconds: float = Field(description="Time of the scan (s)")
    contrast_db: float = Field(description="Peak over the root mean square 3 to 10 diameters beside the vessel")
    side_lobes_db: float | None = Field(description="The same without noise; null with the iterative method")
    width: float | None = Field(description="Full width at half maximum across the vessel as it will read (m)")
    width_scatter: float | None = Field(description="Its standard deviation over itself; null: it often has none")
    resolution: float | None = Field(description="Width of the image of a thin line (m)")
    usable: bool = Field(description="Whether the scatter is at most 5 %, so that 19 of 20 widths are within 10 %")
    proposed: bool = Field(description="Whether it is the fewest points within 1 dB of the highest usable contrast")


class BudgetView(BaseModel):
    """Splits of the pulses, by rising number of points."""

    pulses: int = Field(description="Pulses that the laser fires in the time")
    noise_db: float = Field(description="Peak of the strongest A-line over the noise of one pulse")
    max_contrast_db: float = Field(description="Contrast that iterative images reach or exceed where it is told")
    modes: int = Field(description="Lateral modes of the simulated images")
    splits: list[SplitView]


@router.post("/budget", summary="Points and averages for a number of pulses", response_model=BudgetView)
async def preview_budget(request: Request, services: ServicesDep, wanted: BudgetRequest) -> Response:
    """Predict contrast, width and resolution of a vessel for each split of the pulses, within about a minute.

    The computation ends when the client disconnects.
    """
    if (wanted.noise is None) == (wanted.scan_id is None):
        raise InvalidInput("noise", "both or neither of noise and scan_id", "one of the two")
    tried = len(wanted.averages or ())
    if wanted.method == "iterative" and not 1 <= tried <= MOST_ITERATIVE:
        raise InvalidInput("averages", tried or None, f"1 to {MOST_ITERATIVE} numbers with the method iterative")
    path = None if wanted.scan_id is None else await run_in_threadpool(file_of, services, wanted.scan_id)
    most = min(MOST_POINTS, services.settings.max_mask_points)
    return Response(await while_connected(request, _split_in_turn(services, wanted, path, most)), media_type=JSON)


async def _split_in_turn(services: ServiceContainer, wanted: BudgetRequest, path: Path | None, most: int) -> bytes:
    async with services.designing:
        return await services.process_pool.submit(_split, wanted, path, most)


def _split(wanted: BudgetRequest, path: Path | None, most: int) -> bytes:
    from steradian.comparisons import design_scan
    from steradian.comparisons.pulse_split import MIN_POINTS
    from steradian.comparisons.vessel_image import MAX_CONTRAST_DB
    from steradian.scans.pulse_noise import read_pulse_noise

    modes = min(MOST_MODES, max(16, round(wanted.aperture / VOXEL)))
    own = ("arrangement", "method", "duration", "noise", "scan_id")
    given: dict[str, Any] = {name: getattr(wanted, name) for name in BudgetRequest.model_fields if name not in own}
    try:
        noise = wanted.noise if path is None else read_pulse_noise(path).noise
        assert noise is not None  # noqa: S101 - one of the two
        found = design_scan(
            time=wanted.duration,
            noise=noise,
            arrangements=(wanted.arrangement,),
            methods=(wanted.method,),
            max_points=max(MIN_POINTS, most),
            modes=modes,
            **given,
        )
    except InvalidInput as error:
        raise InvalidInput(FIELDS.get(error.field, error.field), error.value, error.allowed) from error
    splits = []
    for split in found.as_json()["splits"]:
        told = {name: split[f"{name}_m"] for name in ("width", "resolution")}
        splits.append(SplitView(**{name: split[name] for name in SplitView.model_fields if name in split}, **told))
    view = BudgetView(
        pulses=found.pulses,
        noise_db=found.noise.decibels,
        max_contrast_db=MAX_CONTRAST_DB,
        modes=modes,
        splits=splits,
    )
    return view.model_dump_json().encode()
