"""The application."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import APIRouter, FastAPI

from steradian import __version__
from steradian.api import health, masks, plans, problems, reconstructions, root, scans
from steradian.api.middleware import BodyLimit, RequestId
from steradian.api.services import Services
from steradian.api.views import BASE
from steradian.settings import Settings


def create_app(settings: Settings) -> FastAPI:
    """Build the application on a data directory whose database is migrated.

    The interactive documentation of the framework is off: it loads its scripts from elsewhere, and laboratories are
    offline. ``/openapi.json`` is served.
    """
    services = Services(settings)

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        services.open()
        yield
        services.close()

    app = FastAPI(
        title="Steradian",
        version=__version__,
        summary="Sparse photoacoustic tomography: masks, plans, scans and reconstructions",
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
        responses=problems.RESPONSES,
    )
    app.state.services = services
    app.add_middleware(BodyLimit, limit=settings.max_upload_bytes)
    app.add_middleware(RequestId)
    problems.install(app)
    versioned = APIRouter(prefix=BASE)
    for module in (root, masks, plans, scans, reconstructions):
        versioned.include_router(module.router)
    app.include_router(versioned)
    app.include_router(health.router)
    problems.describe(app)
    return app
