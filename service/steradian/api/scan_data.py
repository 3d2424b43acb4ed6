"""``/scans/{id}/…``: what a scan measured."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import h5py
import numpy as np
from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.arrays import ARRAY_ANSWER, JSON, NPY, RAW, Selection, negotiate, respond
from steradian.api.conditions import ConditionsNeeded, etag_of_file
from steradian.api.dependencies import ServicesNeeded, Wait
from steradian.api.files import RANGED, RangedFile
from steradian.api.identifiers import SCAN_ID
from steradian.api.problems import NotReady
from steradian.api.scans import is_settled
from steradian.api.security import V1, GuardedRoute
from steradian.api.services import Services
from steradian.errors import DamagedFile, NotFound
from steradian.plain import nulls
from steradian.scans import schema
from steradian.scans.locking import open_to_read
from steradian.scans.rows import RowTable

router = APIRouter(prefix=f"{V1}/scans", tags=["scans"], route_class=GuardedRoute)

Points = Annotated[
    str | None,
    Query(max_length=60, description="Points of the mask, frame after frame, numpy syntax", examples=["0:100"]),
]
Slice = Annotated[
    str | None,
    Query(max_length=60, description="Points and samples (axes of the answer), numpy syntax", examples=["0:10,::2"]),
]


class ShotsView(BaseModel):
    """Each point's shot, in the order of the mask, frame after frame."""

    points: list[int] = Field(description="Indices into the mask")
    frames: list[int] = Field(description="Which frame, from 0: how often, or at which excitation wavelength")
    stored: list[bool] = Field(description="Whether the A-line is in the file")
    shot: list[int] = Field(description="Number of the laser shot, from 1")
    fire_time: list[float | None] = Field(description="s, on the scanner's clock")
    energy: list[float | None] = Field(description="Pulse energy, the scanner's unit")
    quality: list[int] = Field(description="Flags of the scanner; 0 is good")
    averages: list[int] = Field(description="Shots really averaged")
    time_zero: list[float | None] = Field(description="s from the laser pulse to the first sample")
    level: list[float | None] = Field(description="DC level of the interferometer in V")
    gain: list[float | None] = Field(description="Gain of the receiver in dB over its usual one")


class CoverageView(BaseModel):
    """How much of the mask is measured."""

    points: int = Field(description="A-lines that the scan is to have, of all frames")
    frames: int
    stored: int
    missing: int
    flagged: int = Field(description="Stored A-lines with a quality flag")
    fired: int = Field(description="Shots that the scanner fired")
    area_fraction: float = Field(description="Share of the aperture that the stored points stand for, over all frames")


@router.get(
    "/{scan_id}/file",
    summary="The A-lines as HDF5",
    response_class=RangedFile,
    openapi_extra=RANGED,
    responses={
        200: {"content": {"application/x-hdf5": {"schema": {"type": "string", "format": "binary"}}}},
    },
)
async def read_scan_file(
    services: ServicesNeeded, scan_id: SCAN_ID, wait: Wait, conditions: ConditionsNeeded
) -> RangedFile:
    """Download the scan file, also in ranges."""
    row = await wait.until(lambda: services.scans.get(scan_id), is_settled)
    if not is_settled(row):
        raise NotReady(f"scan {scan_id} is {row.state}; its file can be had when it is over")
    path = await run_in_threadpool(_file, services, scan_id)
    etag = etag_of_file(path)
    conditions.tag(etag)
    return RangedFile(path, media_type="application/x-hdf5", filename=f"{scan_id}.h5", headers={"ETag": etag})


@router.get("/{scan_id}/shots", summary="What became of each shot")
def read_scan_shots(services: ServicesNeeded, scan_id: SCAN_ID, points: Points = None) -> ShotsView:
    """Show status, shot number, time, energy and quality of each point, also while the scan runs."""
    with _opened(services, scan_id) as file:
        columns, mask = RowTable.of_file(file).columns, len(file["mask/weights"])
    count = len(columns["status"])
    chosen = Selection.parse(points, (count,), "points").index[0]
    rows = slice(chosen, chosen + 1) if isinstance(chosen, int) else chosen
    places = np.arange(*rows.indices(count))
    return ShotsView(
        points=(places % mask).tolist(),
        frames=(places // mask).tolist(),
        stored=(columns["status"][rows] == schema.STORED).tolist(),
        shot=columns["shot"][rows].tolist(),
        fire_time=nulls(columns["fire_time_s"][rows]),
        energy=nulls(columns["energy"][rows]),
        quality=columns["quality"][rows].tolist(),
        averages=columns["averages"][rows].tolist(),
        time_zero=nulls(columns["time_zero_s"][rows]),
        level=nulls(columns["dc_v"][rows]),
        gain=nulls(columns["gain_db"][rows]),
    )


@router.get(
    "/{scan_id}/alines",
    summary="A-lines as an array",
    response_class=Response,
    responses={200: ARRAY_ANSWER},
)
def read_scan_alines(
    services: ServicesNeeded, request: Request, scan_id: SCAN_ID, conditions: ConditionsNeeded, slice: Slice = None
) -> Response:
    """Read A-lines (points, samples) in digitiser counts, also while the scan runs; an ETag comes when it is over."""
    kind = negotiate(request, (NPY, RAW, JSON))
    path = _file(services, scan_id)
    headers = {"X-Axes": "point,time", "Vary": "Accept"}
    if is_settled(services.scans.get(scan_id)):
        headers["ETag"] = etag_of_file(path, kind=kind)
        conditions.tag(headers["ETag"], vary="Accept")
    return respond(path, "alines/samples", slice, kind, limit=services.settings.max_volume_bytes, headers=headers)


@router.get("/{scan_id}/coverage", summary="How much of the mask is measured")
def read_scan_coverage(services: ServicesNeeded, scan_id: SCAN_ID) -> CoverageView:
    """Count points and the area they stand for, also while the scan runs."""
    with _opened(services, scan_id) as file:  # two columns of twelve: this is asked for again and again
        status, weights = file["alines/status"][:], file["mask/weights"][:]
        quality, fired = file["alines/quality"][:], int(file["fired"][()])
    stored = (status == schema.STORED).reshape(-1, len(weights))
    return CoverageView(
        points=stored.size,
        frames=len(stored),
        stored=int(stored.sum()),
        missing=int((~stored).sum()),
        flagged=int((stored.ravel() & (quality != 0)).sum()),
        fired=fired,
        area_fraction=float((stored @ weights).sum() / (len(stored) * weights.sum())),
    )


def _file(services: Services, scan_id: str) -> Path:
    services.scans.get(scan_id)
    path = services.data.scan_file(scan_id)
    if not path.is_file():
        raise NotFound("file of scan", scan_id)
    return path


@contextmanager
def _opened(services: Services, scan_id: str) -> Iterator[h5py.File]:
    path = _file(services, scan_id)
    try:
        with open_to_read(path) as file:
            yield file
    except (OSError, KeyError) as error:
        raise DamagedFile(f"the file of scan {scan_id} cannot be read: {error}") from error
