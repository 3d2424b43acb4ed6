"""``/api/v1``: service version, limits and links."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter, Request
from pydantic import BaseModel, Field

from steradian._version import __version__
from steradian.api.errors.catalog import ROOT
from steradian.api.http.array_response import CSV, JSON, NPY, RAW
from steradian.api.http.urls import address, link
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import ServicesDep, longest_wait
from steradian.jobs.requests import SUFFIXES

router = APIRouter(prefix=V1, tags=["service"], route_class=AuthorizedRoute)


class RootView(BaseModel):
    """Entry point of the API: version, mode, limits, formats and links."""

    name: Literal["steradian"] = "steradian"
    version: str = Field(description="Version of the software")
    api: Literal["v1"] = "v1"
    mode: Literal["simulated", "real"] = Field(description="Whether scans run on a simulated scanner")
    limits: dict[str, float] = Field(
        description="Largest mask (points), body, upload, volume (bytes), wait (s); bytes of the disk that stay free,"
        " and that uploads and jobs may take now"
    )
    formats: dict[str, list[str]] = Field(description="Available formats")
    links: dict[str, str]


_FORMATS = {
    "points": [JSON, CSV, NPY],
    "alines": [NPY, RAW, JSON],
    "volume": [NPY, RAW, JSON],
    "mip": ["image/png", NPY, RAW, JSON],
    "picture": ["image/png"],
    "measurements": [JSON, CSV],
    "export": list(SUFFIXES),
}


@router.get("", summary="The service, its mode, limits and links")
@router.get("/", include_in_schema=False)
def read_root(services: ServicesDep, request: Request) -> RootView:
    """Return the service's name, version, limits and links."""
    settings = services.settings
    return RootView(
        version=__version__,
        mode="simulated" if services.nodes.are_simulated else "real",
        limits={
            "mask_points": settings.max_mask_points,
            "body_bytes": settings.max_upload_bytes,
            "upload_bytes": settings.max_import_bytes,
            "volume_bytes": settings.max_volume_bytes,
            "disk_reserve_bytes": settings.disk_reserve_bytes,
            "disk_available_bytes": services.disk.available,
            "wait_seconds": longest_wait(request),
        },
        formats=_FORMATS,
        links={
            **{
                name: link(f"/{name}")
                for name in ("masks", "plans", "scanners", "scans", "reconstructions", "batches", "jobs")
            },
            "storage": link("/storage"),
            "session": link("/session"),
            "events": link("/events"),
            "openapi": address("/openapi.json"),
            "docs": address("/docs"),
            "problems": address(ROOT),
            "metrics": address("/metrics"),
            "health": address("/healthz"),
            "ready": address("/readyz"),
        },
    )
