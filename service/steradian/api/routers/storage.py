"""``/storage``: disk usage of the data folder and free space."""

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
    """Disk usage of the data folder, free space and reserve."""

    used_bytes: dict[str, int] = Field(
        description="Contents of the folder by purpose",
        examples=[{"scans": 52000000, "reconstructions": 210000000}],
    )
    free_bytes: int = Field(description="Free on the disk")
    reserve_bytes: int = Field(description="Stay free, for the database, logs and scans under way")
    available_bytes: int = Field(description="Bytes available to the next upload or job")


@router.get("", summary="Usage of the data folder, and free space")
async def read_storage(services: ServicesDep) -> StorageView:
    """Return the disk usage of the data folder; concurrent requests share one count."""
    try:
        used = await services.usage.load(None)
        return await run_in_threadpool(_view, services, used)
    except OSError as error:
        raise StoreUnavailable(f"the data folder is away: {error.strerror}") from error


def _view(services: ServiceContainer, used: dict[str, int]) -> StorageView:
    disk = services.disk
    return StorageView(
        used_bytes=used, free_bytes=disk.free, reserve_bytes=disk.reserve, available_bytes=disk.available
    )
