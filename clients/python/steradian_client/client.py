"""The clients: the service's nouns, one attribute each, blocking or awaited."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from steradian_client import routes
from steradian_client.addresses import Address
from steradian_client.events import Events
from steradian_client.models import Health, Readiness, Service, Storage
from steradian_client.resources.batches import Batches
from steradian_client.resources.jobs import Jobs
from steradian_client.resources.masks import Masks
from steradian_client.resources.plans import Plans
from steradian_client.resources.reconstructions import Reconstructions
from steradian_client.resources.scanners import Scanners
from steradian_client.resources.scans import Scans
from steradian_client.resources.transfers import Exports, Imports, Uploads
from steradian_client.session import PATIENCE, Session
from steradian_client.transport import AwaitedTransport, BlockingTransport
from steradian_client.worlds import Awaited, Blocking, Resource, World, operation


class _Nouns(Resource[World]):
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

    _transport: type[BlockingTransport | AwaitedTransport]

    def __init__(
        self, url: str | None = None, *, key: str | None = None, timeout: float = 30.0, patience: float = PATIENCE
    ) -> None:
        address = Address.find(url, key)
        super().__init__(Session(self._transport(address.url, address.key, timeout), patience))
        self.masks: Masks[World] = Masks(self._session)
        self.plans: Plans[World] = Plans(self._session)
        self.scanners: Scanners[World] = Scanners(self._session)
        self.scans: Scans[World] = Scans(self._session)
        self.reconstructions: Reconstructions[World] = Reconstructions(self._session)
        self.batches: Batches[World] = Batches(self._session)
        self.jobs: Jobs[World] = Jobs(self._session)
        self.uploads: Uploads[World] = Uploads(self._session)
        self.imports: Imports[World] = Imports(self._session)
        self.exports: Exports[World] = Exports(self._session)
        self.events: Events[World] = Events(self._session)

    @operation
    async def about(self) -> Service:
        """Return the service's version, mode and limits."""
        return await self._session.ask(Service, routes.READ_ROOT)

    @operation
    async def storage(self) -> Storage:
        """Return the bytes used in the data folder by category, and the bytes available."""
        return await self._session.ask(Storage, routes.READ_STORAGE)

    @operation
    async def health(self) -> Health:
        """Ask whether the process answers."""
        return await self._session.ask(Health, routes.HEALTH)

    @operation
    async def readiness(self) -> Readiness:
        """Return whether the service is ready, and the failed checks."""
        return await self._session.ask(Readiness, routes.READINESS, accepted=frozenset({503}))

    @operation
    async def metrics(self) -> str:
        """Return the metrics in Prometheus's text format."""
        return (await self._session.exchange(routes.METRICS)).text

    @operation
    async def close(self) -> None:
        """Close the connections."""
        await self._session.transport.close()


class Client(_Nouns[Blocking]):
    """A connection to a Steradian service.

    Examples
    --------
    >>> with Client("http://127.0.0.1:8000") as service:                       # doctest: +SKIP
    ...     mask = service.masks.equi_steradian(aperture=13.56e-3, depth=3.6e-3, count=1600)
    ...     scan = service.scans.wait(service.scans.create(service.plans.create(mask.id).id), progress=print)
    ...     job = service.reconstructions.wait(service.reconstructions.create(scan.id, modes=226), progress=print)
    ...     service.reconstructions.save_mip(job.id, "mip-z.png", axis="z")
    """

    _transport = BlockingTransport

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class AsyncClient(_Nouns[Awaited]):
    """A connection whose every method is awaited, under asyncio or trio.

    Examples
    --------
    >>> async with AsyncClient("http://127.0.0.1:8000") as service:            # doctest: +SKIP
    ...     scan = await service.scans.wait("s01jz0000000000000000000000", progress=print)
    """

    _transport = AwaitedTransport

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()
