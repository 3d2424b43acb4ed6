"""``/scans/{id}/signals``: statistics of a scan's A-lines, without reconstruction."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.errors.handlers import NotReady
from steradian.api.http.array_response import JSON
from steradian.api.http.conditional import ReadPreconditionsDep, etag_of_file
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import ServicesDep
from steradian.api.params.path import SCAN_ID
from steradian.api.routers.scan_data import file_of, opened
from steradian.api.routers.scans import is_settled
from steradian.core.exceptions import InvalidInput
from steradian.scans.file import schema

if TYPE_CHECKING:
    import h5py

router = APIRouter(prefix=f"{V1}/scans", tags=["scans"], route_class=AuthorizedRoute)
Frame = Annotated[int, Query(ge=0, description="Number of the frame")]
MOST_BYTES = 2_000_000_000
"""Largest frame, as samples in the file, that is inspected while somebody waits."""


class HistogramView(BaseModel):
    """Histogram of samples with bins of equal width."""

    kind: Literal["codes", "values"] = Field(description="codes: of the digitiser; values: of anything else")
    edges: list[float]
    counts: list[int]
    clipped_low: int = Field(description="Consecutive samples at the least value")
    clipped_high: int = Field(description="Consecutive samples at the greatest value")
    missing_codes: int | None = Field(description="Codes between the least and the greatest that no sample has")
    mid_scale_offset: float | None = Field(description="Mean of all samples, in codes")


class SpectrumView(BaseModel):
    """Noise power spectrum, from the quietest of eight equal windows of each A-line."""

    frequencies: list[float] = Field(description="Hz")
    mean: list[float]
    median: list[float]


class SignalMapsView(BaseModel):
    """Maps of A-line statistics by position; of every n-th A-line, so that there are 20,000 at most."""

    x: list[float] = Field(description="m")
    y: list[float] = Field(description="m")
    power: list[float] = Field(description="Variance")
    baseline_mean: list[float] = Field(description="Mean of the quiet part")
    baseline_variance: list[float] = Field(description="Variance of the quiet part")
    arrival: list[float | None] = Field(description="s after the laser pulse; null: none found")


class PartView(BaseModel):
    """Statistics of the A-lines of one beam or one frame."""

    beam: int | None = None
    frame: int | None = None
    alines: int
    power: float | None = None
    power_spread: float | None = Field(None, description="Standard deviation")
    baseline: float | None = None
    baseline_spread: float | None = Field(None, description="Standard deviation")
    gain: float | None = Field(None, description="Mean gain in dB over the usual one")
    delay: float | None = Field(None, description="Mean time of the first sample after the pulse, in s")


class BadLineView(BaseModel):
    """A-line detected as bad; the scan file is not changed."""

    aline: int = Field(description="Its place in the array of A-lines: point of the mask, frame after frame")
    x: float = Field(description="m")
    y: float = Field(description="m")
    kind: Literal["dead", "noisy", "inverted", "saturated", "shifted"]
    detail: str
    mend: Literal["leave-out", "sign", "shift"] = Field(description="Correction that would repair it")


class SignalsView(BaseModel):
    """Statistics of the A-lines stored so far for a frame of a scan, in digitiser counts."""

    alines: int = Field(description="A-lines that the frame is to have")
    samples: int = Field(description="Of each A-line")
    sampling_interval: float = Field(description="s")
    looked_at: int
    complete: bool
    decidable: bool = Field(description="Whether neighbours are similar enough to detect inverted and shifted A-lines")
    histogram: HistogramView
    spectrum: SpectrumView
    maps: SignalMapsView
    beams: list[PartView]
    frames: list[PartView]
    bad: list[BadLineView] = Field(description="5,000 at most")
    bad_counts: dict[str, int] = Field(description="Of all bad A-lines, by kind")


@router.get("/{scan_id}/signals", summary="Statistics of the A-lines", response_model=SignalsView)
async def read_scan_signals(
    services: ServicesDep, scan_id: SCAN_ID, conditions: ReadPreconditionsDep, frame: Frame = 0
) -> Response:
    """Inspect the A-lines of a frame, also while the scan runs: codes, noise, baseline, arrival, and bad A-lines.

    Frames of more than 2 GB of samples are refused. An ETag comes when the scan is over.
    """
    path = await run_in_threadpool(file_of, services, scan_id)
    headers = {}
    if is_settled(await run_in_threadpool(services.scans.get, scan_id)):
        headers["ETag"] = etag_of_file(path, kind=f"signals-{frame}")
        conditions.tag(headers["ETag"])

    def check() -> None:
        with opened(services, scan_id) as file:
            _check(file, scan_id, frame)

    await run_in_threadpool(check)
    return Response(await services.process_pool.submit(_look, path, frame), media_type=JSON, headers=headers)


def _check(file: h5py.File, scan_id: str, frame: int) -> None:
    """Reject a frame that does not exist, has no A-line yet, or is too large."""
    points, samples = len(file["mask/weights"]), file["alines/samples"]
    frames = len(samples) // points
    if frame >= frames:
        raise InvalidInput("frame", frame, f"a whole number, 0 to {frames - 1}")
    size = points * samples.shape[1] * samples.dtype.itemsize
    if size > MOST_BYTES:
        raise InvalidInput("frame", f"{size} bytes", f"up to {MOST_BYTES} bytes of samples; use 'steradian look'")
    if not np.any(file["alines/status"][frame * points : (frame + 1) * points] == schema.STORED):
        raise NotReady(f"scan {scan_id} has no A-line of frame {frame} yet")


def _look(path: Path, frame: int) -> bytes:
    from steradian.scans.inspection import inspect_scan

    return json.dumps(inspect_scan(path, frame).to_dict()).encode()
