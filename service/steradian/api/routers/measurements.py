"""``/reconstructions/{id}/measurements``: named measurements in a volume, kept with it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any, Self

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, model_validator

from steradian.api.http.array_response import CSV, JSON, negotiate
from steradian.api.http.conditional import (
    ReadPreconditionsDep,
    WritePreconditionsDep,
    etag_of_file,
    resource_etag,
)
from steradian.api.http.file_response import open_or_404
from steradian.api.http.urls import link
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import ServicesDep
from steradian.api.params.path import RECONSTRUCTION_ID
from steradian.api.schemas.reports import ObjectWidth
from steradian.api.schemas.resources import BASE
from steradian.api.services import ServiceContainer
from steradian.api.use_cases.admission import volume_size
from steradian.core.exceptions import InvalidInput
from steradian.core.validation import Value
from steradian.jobs.request_base import Identifier
from steradian.quality.tables import csv_text
from steradian.reconstructions.studies.named_measurements import Measurement, measure_named
from steradian.reconstructions.volumes.reader import stored_volume
from steradian.storage.blobs.interface import result_name
from steradian.storage.data_dir.job_directory import SERIES, VOLUME
from steradian.storage.db.tables import JobRow
from steradian.storage.repositories import filters
from steradian.storage.repositories.measurements import Items
from steradian.storage.state_machines import ReconstructionState

router = APIRouter(prefix=f"{V1}/reconstructions", tags=["reconstructions"], route_class=AuthorizedRoute)
MAX_MEASUREMENTS, MAX_VOLUMES = 100, 100
MAX_WIDTH_JOBS = 500
EXAMPLE: dict[str, Any] = {
    "kind": "profile", "name": "profile 1", "axis": "z", "slab": [2e-3, 3e-3], "start": [-1e-3, 0], "end": [1e-3, 0],
}  # fmt: skip
_CORRECTED = ("point_spread", "corrected", "at_most", "shape")
_PLACE = ("axis", "slab", "start", "end", "background_start", "background_end")
_definition: TypeAdapter[Measurement] = TypeAdapter(Measurement)


class MeasurementsWish(Value):
    """All named measurements of a volume, as requested."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"items": [EXAMPLE]}]})

    items: tuple[Measurement, ...] = Field(max_length=MAX_MEASUREMENTS)

    @model_validator(mode="after")
    def _check(self) -> Self:
        names = [item.name for item in self.items]
        for number, name in enumerate(names):
            if name in names[:number]:
                raise InvalidInput(f"items.{number}.name", name, "a name that no other measurement has")
        return self


class MeasurementView(BaseModel):
    """Named measurement with its values, and the corrected width of a profile."""

    reconstruction_id: str
    measurement: Measurement
    figures: dict[str, float | None] = Field(
        description="Lengths in m; value is the peak's height above the base, the mean, the contrast-to-noise ratio or"
        " the value at the point",
        examples=[{"value": 0.4, "width": 1.2e-4, "repeatability": 2e-6}],
    )
    ends: list[list[float]] = Field(
        description="x, y, z of the ends of a profile in the slice through its peak (m), start and end of a width job"
    )
    reason: str = Field(description="Why there is no value or width; empty where there is one")
    state: ReconstructionState | None = Field(description="Of the newest width job along this profile; null: none")
    correction: ObjectWidth | None = Field(description="What it found in that slice: point spread, corrected diameter")
    links: dict[str, str] = Field(examples=[{"job": f"{BASE}/jobs/…"}])

    def row(self) -> dict[str, Any]:
        """Return the measurement as one row of a table."""
        said = self.measurement.model_dump()
        of = {"reconstruction_id": self.reconstruction_id}
        about = {name: said.get(name) for name in ("name", "kind", "index")}
        corrected = {name: getattr(self.correction, name, None) for name in _CORRECTED}
        reason = self.reason or getattr(self.correction, "reason", None)
        return of | about | self.figures | corrected | {"reason": reason} | {name: said.get(name) for name in _PLACE}


class MeasurementsView(BaseModel):
    """Named measurements of a volume, in the order of their definition."""

    items: list[MeasurementView]


@router.put("/{reconstruction_id}/measurements", summary="Replace the named measurements of a volume")
def set_reconstruction_measurements(
    services: ServicesDep,
    reconstruction_id: RECONSTRUCTION_ID,
    wanted: MeasurementsWish,
    conditions: WritePreconditionsDep,
) -> MeasurementsView:
    """Store named measurements with the volume and return their values; with If-Match only if they have not changed.

    Values of a measurement that is already stored are not computed again, because a volume does not change.
    """
    volume_size(services, reconstruction_id, "reconstruction_id")  # raises unless there is a volume
    _, known = services.measurements.get(reconstruction_id)
    items = [
        _stored(known, item) or _measured(services, reconstruction_id, number, item)
        for number, item in enumerate(wanted.items)
    ]
    revision = services.measurements.put(reconstruction_id, items, conditions.revision(reconstruction_id))
    view = _view(services, reconstruction_id, items)
    conditions.tag(resource_etag(reconstruction_id, revision, view))
    return view


@router.get(
    "/{reconstruction_id}/measurements",
    summary="Named measurements of a volume",
    response_model=MeasurementsView,
    responses={200: {"content": {CSV: {"schema": {"type": "string"}}}}},
)
def read_reconstruction_measurements(
    services: ServicesDep,
    request: Request,
    reconstruction_id: RECONSTRUCTION_ID,
    conditions: ReadPreconditionsDep,
    also: Annotated[
        list[Identifier] | None,
        Query(max_length=MAX_VOLUMES, description="Other reconstructions whose measurements follow in the same table"),
    ] = None,
) -> Response:
    """Return the named measurements of a volume, or of several, with their values, as JSON or as CSV in SI units."""
    kind = negotiate(request, (JSON, CSV))
    view, revision = MeasurementsView(items=[]), 0
    for number, identifier in enumerate((reconstruction_id, *(also or ()))):
        services.ledger.reconstruction(identifier)
        known, items = services.measurements.get(identifier)
        revision = revision if number else known
        view.items.extend(_view(services, identifier, items).items)
    etag = resource_etag(reconstruction_id, revision if kind == JSON else f"csv-{revision}", view)
    conditions.tag(etag, vary="Accept")
    body = view.model_dump_json() if kind == JSON else csv_text([item.row() for item in view.items])
    return Response(body, media_type=kind, headers={"ETag": etag, "Vary": "Accept"})


def _stored(known: Items, wanted: Measurement) -> dict[str, Any] | None:
    """Return a measurement with its values if it is stored already, perhaps with another name."""
    definition = wanted.model_dump(mode="json")
    for item in known:
        if item["definition"] | {"name": wanted.name} == definition:
            return item | {"definition": definition}
    return None


def _measured(services: ServiceContainer, reconstruction_id: str, number: int, wanted: Measurement) -> dict[str, Any]:
    frames = (services.ledger.reconstruction(reconstruction_id).result or {}).get("frames")
    name = result_name(reconstruction_id, SERIES if frames else VOLUME)
    path = open_or_404(services.arrays, name, "volume of", reconstruction_id)
    try:
        found = measure_named(stored_volume(path, etag_of_file(path), wanted.index), wanted)
    except InvalidInput as error:
        raise InvalidInput(f"items.{number}.{error.field}", error.value, error.allowed) from error
    return {"definition": wanted.model_dump(mode="json")} | asdict(found)


def _view(services: ServiceContainer, reconstruction_id: str, items: Items) -> MeasurementsView:
    where = filters.jobs(kind="width", reconstruction_id=reconstruction_id)
    jobs = services.ledger.page(MAX_WIDTH_JOBS, None, where).rows if any(item["ends"] for item in items) else []
    by_line: dict[Any, JobRow] = {}
    for row in reversed(jobs):  # the newest is the last
        by_line[_line(row.payload.get("index"), [row.payload["start"], row.payload["end"]])] = row
    views = []
    for item in items:
        job = by_line.get(_line(item["definition"]["index"], item["ends"]))
        width = None if job is None else (job.result or {}).get("width")
        views.append(
            MeasurementView(
                reconstruction_id=reconstruction_id,
                measurement=_definition.validate_python(item["definition"]),
                figures=item["figures"],
                ends=[list(end) for end in item["ends"]],
                reason=item["reason"],
                state=None if job is None else job.state,
                correction=None if width is None else ObjectWidth.model_validate(width),
                links={} if job is None else {"job": link(f"/jobs/{job.id}")},
            )
        )
    return MeasurementsView(items=views)


def _line(index: int | None, ends: Any) -> Any:
    return index, *(tuple(end) for end in ends)
