"""Factory of the FastAPI application: middleware, exception handlers and routers."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI
from starlette.types import ASGIApp

from steradian._version import __version__
from steradian.api.errors import handlers as problems
from steradian.api.errors import problem_pages as problem_pages
from steradian.api.http.urls import PathPrefixMiddleware, address
from steradian.api.middleware.authentication import AuthenticationMiddleware
from steradian.api.middleware.base import (
    AccessLogMiddleware,
    BodySizeLimitMiddleware,
    HeadMiddleware,
    MaxStreamsMiddleware,
    RejectNulMiddleware,
    RequestIdMiddleware,
)
from steradian.api.middleware.cors import Cors
from steradian.api.middleware.metrics import Metrics
from steradian.api.middleware.response_cache import CoalescingCacheMiddleware
from steradian.api.middleware.validator_loader import CacheValidatorLoader
from steradian.api.openapi import postprocess as contract
from steradian.api.openapi import swagger_page as documentation
from steradian.api.routers import (
    batches,
    budgets,
    deletion,
    designs,
    events,
    health,
    jobs,
    masks,
    measurements,
    metrics,
    plans,
    quality,
    reconstruction_data,
    reconstructions,
    root,
    scan_data,
    scanners,
    scans,
    sessions,
    signals,
    storage,
    uploads,
)
from steradian.api.routers import emergency_stop as stops
from steradian.api.services import ServiceContainer
from steradian.api.streaming.broadcaster import EventBroadcaster
from steradian.core.settings import Settings
from steradian.web.pages import make_router

ROUTER_MODULES = (
    events, root, masks, plans, designs, budgets, scanners, scans, scan_data, signals, reconstructions,
    reconstruction_data, measurements, quality, batches, uploads, jobs, deletion, storage, sessions, stops,
)  # fmt: skip
"""In the order in which a request is compared with their routes; streams are opened by many at once."""


class Application(FastAPI):
    """FastAPI application inside :class:`PathPrefixMiddleware`, which strips a proxy's path prefix first."""

    root = ""

    def build_middleware_stack(self) -> ASGIApp:
        """Return the framework's middleware stack, wrapped in :class:`PathPrefixMiddleware`."""
        return PathPrefixMiddleware(super().build_middleware_stack(), self.root)


def create_app(settings: Settings) -> FastAPI:
    """Create the FastAPI application for a data directory with a migrated database.

    The framework's documentation page is disabled, because it loads scripts from other hosts; ``/docs`` replaces it.
    """
    services = ServiceContainer(settings)

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        services.open()
        yield
        services.close()

    app = Application(
        title="Steradian",
        version=__version__,
        summary="Sparse photoacoustic tomography: masks, plans, scans and reconstructions",
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
        license_info={"name": "Apache 2.0", "identifier": "Apache-2.0"},
        generate_unique_id_function=contract.name_operation,
    )
    app.root = settings.root_path
    app.state.services = services
    app.state.routes = []
    app.state.feed = EventBroadcaster(services)
    app.state.metrics = Metrics(services)
    app.add_middleware(CoalescingCacheMiddleware, stamp=CacheValidatorLoader(services.database).of)
    app.add_middleware(HeadMiddleware)
    app.add_middleware(BodySizeLimitMiddleware, settings=settings)
    app.add_middleware(AuthenticationMiddleware, keeper=services)
    app.add_middleware(Cors, origins=settings.origins)
    app.add_middleware(RejectNulMiddleware)
    app.add_middleware(MaxStreamsMiddleware)
    app.add_middleware(AccessLogMiddleware, metrics=app.state.metrics)
    app.add_middleware(RequestIdMiddleware)
    problems.install_handlers(app)
    routers = [module.router for module in (*ROUTER_MODULES, health, metrics, documentation, problem_pages)]
    for router in (*routers, make_router(__version__, settings.page_scripts, address)):
        app.include_router(router)
        app.state.routes += router.routes
    contract.install_openapi(app)
    return app
