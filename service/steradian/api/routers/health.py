"""``/healthz`` and ``/readyz``: liveness and readiness probes."""

from __future__ import annotations

import shutil
import time

from fastapi import APIRouter, Response
from pydantic import BaseModel, Field
from sqlalchemy.exc import SQLAlchemyError

from steradian._version import __version__
from steradian.api.params.dependencies import ServicesDep
from steradian.api.services import ServiceContainer
from steradian.core.exceptions import InvalidInput
from steradian.runtime.heartbeat import is_alive
from steradian.storage.maintenance.folder_binding import check_binding
from steradian.storage.maintenance.permissions import unwritable_part

router = APIRouter(tags=["health"])
MIN_FREE_BYTES = 100 * 2**20
"""Below this much free space nothing can be measured or reconstructed."""


class Health(BaseModel):
    """Liveness of the process, with its version."""

    status: str = "ok"
    version: str = __version__


class Readiness(BaseModel):
    """Readiness checks by name."""

    ready: bool
    checks: dict[str, bool]
    reasons: dict[str, str] = Field(default_factory=dict, description="Reasons of failed checks")


@router.get("/healthz", summary="Whether the process answers")
async def read_health() -> Health:
    """Return the liveness of the process, without any check."""
    return Health()


@router.get(
    "/readyz",
    summary="Whether work can be taken",
    responses={503: {"model": Readiness, "description": "Something that work needs is missing"}},
)
def read_readiness(services: ServicesDep, response: Response) -> Readiness:
    """Check database, store, folder, queue and processes; a scanner that is unplugged does not make it unready."""
    closed = unwritable_part(services.data)
    checks = readiness_checks(services, time.time()) | {"folder": closed is None}
    ready = all(checks.values())
    response.status_code = 200 if ready else 503
    return Readiness(ready=ready, checks=checks, reasons={} if closed is None else {"folder": closed})


def readiness_checks(services: ServiceContainer, now: float) -> dict[str, bool]:
    """Return the readiness checks by name: database, array store, disk, queue and the processes' heartbeats."""
    settings = services.settings
    processes = ["acquisition"] if settings.has_scanner else []
    processes += [settings.worker_slot_name(slot) for slot in range(settings.workers)] if settings.has_scanner else []
    return {
        "database": database_responds(services),
        "store": _is_mounted(services) and services.arrays.is_available(),
        "disk": has_free_space(services),
        "queue": services.queue_is_open,
        **{name: is_alive(services.data.heartbeat(name), now) for name in processes},
    }


def has_free_space(services: ServiceContainer) -> bool:
    """Return whether the data folder's disk has more than the minimum of free bytes."""
    try:
        return shutil.disk_usage(services.data.root).free > MIN_FREE_BYTES
    except OSError:  # the folder is gone, or its host
        return False


def _is_mounted(services: ServiceContainer) -> bool:
    """Return whether the data folder is the database's; an unmounted mount point is an empty folder."""
    if services.settings.role != "service":
        return True
    try:
        check_binding(services.database, services.data)  # with a store, too: what is measured lies there at first
    except InvalidInput:
        return False
    except SQLAlchemyError:
        pass  # the database's own check says so
    return True


def database_responds(services: ServiceContainer) -> bool:
    """Return whether the database answers a query."""
    try:
        services.database.check()
    except SQLAlchemyError:
        return False
    return True
