"""Base classes of resource collections with the operations read, list, delete and wait."""

from __future__ import annotations

import builtins
from collections.abc import Mapping
from typing import Any, Generic, TypeVar

from steradian_client.models import ResponseModel
from steradian_client.polling import CompletionWaiter, Report
from steradian_client.polling import Kind as WorkKind
from steradian_client.routes import Route
from steradian_client.sync_async import Mode, Resource, dual_method

ModelT = TypeVar("ModelT", bound=ResponseModel)


def id_of(thing: Any) -> str:
    """Return the identifier of a model; a string is returned unchanged."""
    return thing if isinstance(thing, str) else str(thing.id)


class CrudResource(Resource[Mode], Generic[Mode, ModelT]):
    """Base class of collections of stored resources: read, list, delete."""

    _kind: type[ModelT]
    _read: Route
    _list: Route
    _delete: Route

    @dual_method
    async def get(self, identifier: str) -> ModelT:
        """Return the resource with this identifier."""
        return await self._session.request_model(self._kind, self._read, {"id": identifier})

    @dual_method
    async def list(self, /, limit: int = 100, **filters: Any) -> builtins.list[ModelT]:
        """Return the newest resources, restricted by the query parameters ``filters``.

        Parameters
        ----------
        filters
            Such as ``state="running"``, ``state=["queued", "running"]``, ``label="phantom=yarn"``, ``scan_id=…``.
        """
        return await self._session.list(self._kind, self._list, limit, filters)

    @dual_method
    async def delete(self, thing: ModelT | str, *, dependents: bool = False) -> None:
        """Delete a resource permanently.

        Parameters
        ----------
        dependents
            Also delete all that depends on it.

        Raises
        ------
        HasDependents, Conflict
            When something depends on it, or it is in use.
        """
        params = {"dependents": True} if dependents else {}
        await self._session.send_with_retries(self._delete, {"id": id_of(thing)}, params=params)


class AwaitableResource(CrudResource[Mode, WorkKind]):
    """Base class of collections whose resources take time: scans, reconstructions, jobs and batches."""

    _event: str | None
    """What the event stream calls them; ``None``: it depends."""

    @dual_method
    async def wait(
        self, work: WorkKind | str, *, progress: Report | None = None, timeout: float | None = None
    ) -> WorkKind:
        """Wait until the resource has ended, also across restarts of the service and broken connections.

        Parameters
        ----------
        progress
            Told of every advance, in the unit of its stage.
        timeout
            Seconds; ``None`` waits as long as it takes.

        Raises
        ------
        JobFailed
            When it did not end well.
        TimeoutError
            When it is not over in time; it goes on.
        """
        return await self._until_over(work, progress, timeout)

    async def _until_over(self, work: WorkKind | str, progress: Report | None, timeout: float | None) -> WorkKind:
        identifier = id_of(work)

        async def look(hold: float) -> WorkKind:
            return await self._session.request_model(self._kind, self._read, {"id": identifier}, wait=hold)

        known = await look(0.0) if isinstance(work, str) else work
        return await CompletionWaiter(self._session, self._event, look, progress, timeout).wait(known)


def drop_none(**values: Any) -> Mapping[str, Any]:
    """Return the keyword arguments that are not None."""
    return {name: value for name, value in values.items() if value is not None}
