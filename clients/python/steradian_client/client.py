"""Blocking and asynchronous client, with one attribute for each resource of the HTTP API."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from steradian_client import routes
from steradian_client.config import Address
from steradian_client.events import Events
from steradian_client.models import Health, Readiness, Service, Storage
from steradian_client.request_session import RETRY_TIMEOUT, RequestSession
from steradian_client.resources.batches import Batches
from steradian_client.resources.exports import Exports
from steradian_client.resources.jobs import Jobs
from steradian_client.resources.masks import Masks
from steradian_client.resources.plans import Plans
from steradian_client.resources.reconstructions import Reconstructions
from steradian_client.resources.scanners import Scanners
from steradian_client.resources.scans import Scans
from steradian_client.resources.transfers import Imports, Uploads
from steradian_client.sync_async import AsyncMode, Mode, Resource, SyncMode, dual_method
from steradian_client.transport import AsyncTransport, SyncTransport


class _ClientBase(Resource[Mode]):
    """Common base of the blocking and the asynchronous client.

    Parameters
    ----------
    url
        Address of the service; ``None``: of the environment (``STERADIAN_URL``), the configuration file, or this
        machine.
    key
        API key; ``None``: of the environment (``STERADIAN_KEY``) or the configuration file, with the address there. A
        service on this machine needs none.
    timeout
        Longest silence while an answer is due (s).
    patience
        Seconds for which a service that is being started anew is waited for.
    """

    _transport: type[SyncTransport | AsyncTransport]

    def __init__(
        self, url: str | None = None, *, key: str | None = None, timeout: float = 30.0, patience: float = RETRY_TIMEOUT
    ) -> None:
        address = Address.resolve(url, key)
        super().__init__(RequestSession(self._transport(address.url, address.key, timeout), patience))
        self.masks: Masks[Mode] = Masks(self._session)
        self.plans: Plans[Mode] = Plans(self._session)
        self.scanners: Scanners[Mode] = Scanners(self._session)
        self.scans: Scans[Mode] = Scans(self._session)
        self.reconstructions: Reconstructions[Mode] = Reconstructions(self._session)
        self.batches: Batches[Mode] = Batches(self._session)
        self.jobs: Jobs[Mode] = Jobs(self._session)
        self.uploads: Uploads[Mode] = Uploads(self._session)
        self.imports: Imports[Mode] = Imports(self._session)
        self.exports: Exports[Mode] = Exports(self._session)
        self.events: Events[Mode] = Events(self._session)

    @dual_method
    async def service_info(self) -> Service:
        """Return the service's version, mode and limits."""
        return await self._session.request_model(Service, routes.READ_ROOT)

    @dual_method
    async def storage(self) -> Storage:
        """Return the bytes used in the data folder by category, and the bytes available."""
        return await self._session.request_model(Storage, routes.READ_STORAGE)

    @dual_method
    async def health(self) -> Health:
        """Return the status and version of the service's process, as a liveness check."""
        return await self._session.request_model(Health, routes.HEALTH)

    @dual_method
    async def readiness(self) -> Readiness:
        """Return whether the service is ready, and the failed checks."""
        return await self._session.request_model(Readiness, routes.READINESS, accepted=frozenset({503}))

    @dual_method
    async def metrics(self) -> str:
        """Return the metrics in Prometheus's text format."""
        return (await self._session.send_with_retries(routes.METRICS)).text

    @dual_method
    async def close(self) -> None:
        """Close all connections to the service."""
        await self._session.transport.close()


class Client(_ClientBase[SyncMode]):
    """Blocking client of a Steradian service.

    Examples
    --------
    >>> with Client("http://127.0.0.1:8000") as service:                       # doctest: +SKIP
    ...     mask = service.masks.equi_steradian(aperture=13.56e-3, depth=3.6e-3, count=1600)
    ...     scan = service.scans.wait(service.scans.create(service.plans.create(mask.id).id), progress=print)
    ...     job = service.reconstructions.wait(service.reconstructions.create(scan.id, modes=226), progress=print)
    ...     service.reconstructions.save_mip(job.id, "mip-z.png", axis="z")
    """

    _transport = SyncTransport

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class AsyncClient(_ClientBase[AsyncMode]):
    """Asynchronous client of a Steradian service, under asyncio or trio.

    Examples
    --------
    >>> async with AsyncClient("http://127.0.0.1:8000") as service:            # doctest: +SKIP
    ...     scan = await service.scans.wait("s01jz0000000000000000000000", progress=print)
    """

    _transport = AsyncTransport

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()
