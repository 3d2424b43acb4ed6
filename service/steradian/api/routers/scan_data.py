"""``/scans/{id}/…``: A-lines, shots, coverage and the scan file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Self

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from numpy.typing import NDArray
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.background.peers import ForwardToPeer
from steradian.api.errors.handlers import NotReady
from steradian.api.http.array_response import (
    ARRAY_ANSWER,
    JSON,
    NPY,
    RAW,
    ArraySlice,
    ArrayView,
    Hdf5Array,
    InMemoryArray,
    array_response,
    negotiate,
)
from steradian.api.http.conditional import ReadPreconditionsDep, etag_of_file
from steradian.api.http.file_response import RANGED, RangeFileResponse, open_or_404
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import ServicesDep, Wait
from steradian.api.params.path import SCAN_ID
from steradian.api.routers.scans import is_settled
from steradian.api.services import ServiceContainer
from steradian.core.exceptions import DamagedFile, NotFound, SteradianError
from steradian.core.json_encoding import nan_to_none, to_jsonable
from steradian.scans.file import schema
from steradian.scans.file.aline_metadata import ShotTable
from steradian.scans.file.h5py_errors import HDF5_ERRORS
from steradian.scans.file.latest_row import latest_row
from steradian.scans.file.locking import open_for_reading
from steradian.storage.blobs.interface import scan_name

if TYPE_CHECKING:
    import h5py

_FLAGS: Final = {"saturated": 1, "mistuned": 2, "misfired": 4, "partial": 8}
router = APIRouter(prefix=f"{V1}/scans", tags=["scans"], route_class=AuthorizedRoute)

Points = Annotated[
    str | None,
    Query(max_length=60, description="Points of the mask, frame after frame, numpy syntax", examples=["0:100"]),
]
Slice = Annotated[
    str | None,
    Query(max_length=60, description="Points and samples (axes of the answer), numpy syntax", examples=["0:10,::2"]),
]
ChangeCursor = Annotated[
    str | None,
    Query(
        max_length=60,
        description="Cursor of an earlier response: only changes since then; everything if it is no longer valid",
        examples=["6f1d0c2a.7"],
    ),
]


class FlagsView(BaseModel):
    """Number of stored A-lines with each of the scanner's quality flags; an A-line may have several."""

    saturated: int
    mistuned: int
    misfired: int
    partial: int = Field(description="Averaged over fewer shots than planned")

    @classmethod
    def of(cls, quality: NDArray[np.uint32]) -> Self:
        """Count the stored A-lines with each quality flag."""
        return cls(**{name: int((quality & bit != 0).sum()) for name, bit in _FLAGS.items()})


class CoverageView(BaseModel):
    """Coverage of a scan: counts of stored, missing and flagged A-lines, and share of the aperture's area."""

    points: int = Field(description="A-lines that the scan is to have, of all frames")
    frames: int
    stored: int
    missing: int
    flagged: int = Field(description="Stored A-lines with a quality flag")
    flags: FlagsView
    fired: int = Field(description="Shots that the scanner fired")
    area_fraction: float = Field(description="Share of the aperture covered by the stored points, over all frames")

    @classmethod
    def of(cls, file: h5py.File, stored: NDArray[np.bool_], quality: NDArray[np.uint32]) -> Self:
        """Return the coverage of an open scan file."""
        weights, good = file["mask/weights"][:], quality[stored]
        frames = stored.reshape(-1, len(weights))
        return cls(
            points=stored.size,
            frames=len(frames),
            stored=len(good),
            missing=stored.size - len(good),
            flagged=int((good != 0).sum()),
            flags=FlagsView.of(good),
            fired=int(file["fired"][()]),
            area_fraction=float((frames @ weights).sum() / (len(frames) * weights.sum())),
        )


class ShotsView(BaseModel):
    """Shot table of a scan: columns with one value for each point, in the order of the mask, frame after frame."""

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
    coverage: CoverageView = Field(description="Counts of all points, also where only some are listed")
    newest: int | None = Field(description="The A-line stored last, as a place in the array of A-lines; null: none")
    next: str = Field(description="Cursor: send it as since to receive only later changes")


class LatestView(ArrayView):
    """Most recently stored A-line of a scan."""

    row: int = Field(description="Its place in the array of A-lines: point of the mask, frame after frame")
    point: int = Field(description="Index into the mask")
    frame: int
    shot: int = Field(description="Number of the laser shot")
    quality: int = Field(description="Flags of the scanner; 0 is good")
    time_zero: float | None = Field(description="s from the laser pulse to the first sample")
    sampling_interval: float = Field(description="s")
    scale: float | None = Field(description="Pressure unit of one digitiser count")


@router.get(
    "/{scan_id}/file",
    summary="The A-lines as HDF5",
    response_class=RangeFileResponse,
    openapi_extra=RANGED,
    responses={
        200: {"content": {"application/x-hdf5": {"schema": {"type": "string", "format": "binary"}}}},
    },
)
async def read_scan_file(
    services: ServicesDep, scan_id: SCAN_ID, wait: Wait, conditions: ReadPreconditionsDep
) -> RangeFileResponse:
    """Download the scan file, also in ranges."""
    row = await wait.wait_for(lambda: services.scans.get(scan_id), is_settled)
    if not is_settled(row):
        raise NotReady(f"scan {scan_id} is {row.state}; its file is available when the scan has ended")
    path = await run_in_threadpool(file_of, services, scan_id)
    etag = etag_of_file(path)
    conditions.tag(etag)
    return RangeFileResponse(path, media_type="application/x-hdf5", filename=f"{scan_id}.h5", headers={"ETag": etag})


@router.get("/{scan_id}/shots", summary="Outcome of each shot")
def read_scan_shots(
    services: ServicesDep, scan_id: SCAN_ID, points: Points = None, since: ChangeCursor = None
) -> ShotsView:
    """Return status, shot number, time, energy and quality of each point, also while the scan runs.

    A client that follows a scan sends ``next`` of each response as ``since`` of the next request and receives only the
    points that have changed, including A-lines that were measured again or no longer count.
    """
    with opened(services, scan_id) as file:
        marks = np.stack([file["alines/crc32c"][:], file["alines/status"][:]], axis=1)
        newest = latest_row(file)
        columns, mask = ShotTable.of_file(file).columns, len(file["mask/weights"])
        coverage = CoverageView.of(file, columns["status"] == schema.STORED, columns["quality"])
    count = len(columns["status"])
    chosen = ArraySlice.parse(points, (count,), "points").index[0]
    wanted = np.zeros(count, bool)
    wanted[chosen] = True
    changed, following = services.shot_inspections.changed_since(scan_id, marks, since)
    rows = np.flatnonzero(wanted & changed)
    told = {name: values[rows] for name, values in columns.items()}
    return ShotsView(
        points=(rows % mask).tolist(),
        frames=(rows // mask).tolist(),
        stored=(told["status"] == schema.STORED).tolist(),
        shot=told["shot"].tolist(),
        fire_time=nan_to_none(told["fire_time_s"]),
        energy=nan_to_none(told["energy"]),
        quality=told["quality"].tolist(),
        averages=told["averages"].tolist(),
        time_zero=nan_to_none(told["time_zero_s"]),
        level=nan_to_none(told["dc_v"]),
        gain=nan_to_none(told["gain_db"]),
        coverage=coverage,
        newest=newest,
        next=following,
    )


@router.get(
    "/{scan_id}/alines",
    summary="A-lines as an array",
    response_class=Response,
    responses={200: ARRAY_ANSWER},
)
def read_scan_alines(
    services: ServicesDep, request: Request, scan_id: SCAN_ID, conditions: ReadPreconditionsDep, slice: Slice = None
) -> Response:
    """Return A-lines (points, samples) in digitiser counts, also while the scan runs; ETag only after its end."""
    kind = negotiate(request, (NPY, RAW, JSON))
    path = file_of(services, scan_id)
    headers = {"X-Axes": "point,time", "Vary": "Accept"}
    if is_settled(services.scans.get(scan_id)):
        headers["ETag"] = etag_of_file(path, kind=kind)
        conditions.tag(headers["ETag"], vary="Accept")
    alines = Hdf5Array(path, "alines/samples")
    selection = ArraySlice.parse(slice, alines.shape)
    return array_response(alines, selection, kind, limit=services.settings.max_volume_bytes, headers=headers)


@router.get(
    "/{scan_id}/alines/latest",
    summary="The A-line stored last",
    response_class=Response,
    responses={200: {**ARRAY_ANSWER, "model": LatestView}},
)
def read_scan_latest_aline(
    services: ServicesDep, request: Request, scan_id: SCAN_ID, conditions: ReadPreconditionsDep
) -> Response:
    """Return the newest A-line in digitiser counts; headers or JSON fields give its index and its time axis in s."""
    kind = negotiate(request, (NPY, RAW, JSON))
    with opened(services, scan_id) as file:
        row = latest_row(file)
        if row is None:
            raise NotReady(f"scan {scan_id} has no A-line yet")
        one = ShotTable.of_file(file, slice(row, row + 1)).columns
        interval, mask = float(file["plan"].attrs["sampling_interval_s"]), len(file["mask/weights"])
        samples = InMemoryArray(file["alines/samples"][row])
    zero, scale = float(one["time_zero_s"][0]), float(one["scale"][0])
    more: dict[str, Any] = {"row": row, "point": row % mask, "frame": row // mask, "shot": int(one["shot"][0])}
    more |= {"quality": int(one["quality"][0]), "time_zero": zero, "sampling_interval": interval, "scale": scale}
    etag = f'"{scan_id}-{row}-{one["crc32c"][0]:08x}-{kind.rpartition("/")[2]}"'
    conditions.tag(etag, vary="Accept")
    headers = {"ETag": etag, "Vary": "Accept", "X-Axes": "time", "X-Row": str(row), "X-Scale": f"{scale:.9g}"}
    headers |= {"X-Origin": f"{zero:.9g}", "X-Spacing": f"{interval:.9g}"}
    limit = services.settings.max_volume_bytes
    return array_response(
        samples, ArraySlice.parse(None, samples.shape), kind, limit=limit, headers=headers, more=to_jsonable(more)
    )


@router.get("/{scan_id}/coverage", summary="How much of the mask is measured")
def read_scan_coverage(services: ServicesDep, scan_id: SCAN_ID) -> CoverageView:
    """Return the coverage of a scan: counts of A-lines and share of the area, also while the scan runs."""
    with opened(services, scan_id) as file:  # two columns of twelve: this is asked for again and again
        status, quality = file["alines/status"][:], file["alines/quality"][:]
        return CoverageView.of(file, status == schema.STORED, quality)


def file_of(services: ServiceContainer, scan_id: str) -> Path:
    """Return the path of a scan's file; raises :class:`ForwardToPeer` while only the scanner's node has the file."""
    scan = services.scans.get(scan_id)
    try:
        return open_or_404(services.arrays, scan_name(scan_id), "file of scan", scan_id)
    except NotFound:
        if scan.scanner_id is None or not services.nodes.is_remote(scan.scanner_id):
            raise
        raise ForwardToPeer(scan.scanner_id) from None


@contextmanager
def opened(services: ServiceContainer, scan_id: str) -> Iterator[h5py.File]:
    """Open a scan's file for reading; errors contain the scan's identifier."""
    path = file_of(services, scan_id)
    try:
        with open_for_reading(path) as file:
            yield file
    except SteradianError:
        raise
    except FileNotFoundError:  # deleted since
        raise NotFound("file of scan", scan_id) from None
    except (OSError, *HDF5_ERRORS) as error:
        raise DamagedFile(f"the file of scan {scan_id} cannot be read: {error}") from error
