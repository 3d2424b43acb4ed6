"""``/storage``: disk usage of the data folder and reserved bytes."""

from __future__ import annotations

from fastapi import APIRouter
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import ServicesDep
from steradian.api.services import ServiceContainer
from steradian.core.exceptions import StoreUnavailable

router = APIRouter(prefix=f"{V1}/storage", tags=["service"], route_class=AuthorizedRoute)


class StorageView(BaseModel):
    """Disk usage of the data folder, with its quota and the free and reserved bytes."""

    used_bytes: dict[str, int] = Field(
        description="Contents of the folder by purpose",
        examples=[{"scans": 52000000, "reconstructions": 210000000}],
    )
    quota_bytes: int | None = Field(description="Quota of the folder; null: the disk's size")
    free_bytes: int = Field(description="Free on the disk")
    reserve_bytes: int = Field(description="Stay free, for the database, logs and scans under way")
    promised_bytes: int = Field(description="Bytes reserved for queued and running scans, jobs and uploads")
    available_bytes: int = Field(description="Bytes available to the next upload or job")


@router.get("", summary="Usage of the data folder, and reserved bytes")
async def read_storage(services: ServicesDep) -> StorageView:
    """Return the disk usage of the data folder; concurrent requests share one count."""
    try:
        used = await services.usage.load(None)
        return await run_in_threadpool(_view, services, used)
    except OSError as error:
        raise StoreUnavailable(f"the data folder is away: {error.strerror}") from error


def _view(services: ServiceContainer, used: dict[str, int]) -> StorageView:
    disk = services.disk
    with services.database.read() as session:
        waiting = services.reserved_bytes(session) + services.arrivals.awaited
    return StorageView(
        used_bytes=used,
        quota_bytes=disk.quota,
        free_bytes=disk.free,
        reserve_bytes=disk.reserve,
        promised_bytes=waiting,
        available_bytes=max(0, disk.available(sum(used.values())) - waiting),
    )
