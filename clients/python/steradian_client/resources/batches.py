"""Collection of batches: many reconstructions of one scan in one request."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from steradian_client import routes
from steradian_client.models import Batch
from steradian_client.resources.base import AwaitableResource, drop_none
from steradian_client.sync_async import Mode, dual_method


class Batches(AwaitableResource[Mode, Batch]):
    """Collection of batches: sweeps of parameters, masks or wavelengths over one scan in one request."""

    _kind, _read, _list, _delete = Batch, routes.READ_BATCH, routes.LIST_BATCHES, routes.DELETE_BATCH
    _event = "batch"

    @dual_method
    async def create(
        self,
        /,
        scan_id: str,
        vary: Mapping[str, Sequence[Any]] | None = None,
        *,
        each: Literal["wavelength", "frame"] | None = None,
        priority: int | None = None,
        points: Literal["nearest", "exact"] | None = None,
        requires: Mapping[str, int] | None = None,
        idempotency_key: str | None = None,
        **parameters: Any,
    ) -> Batch:
        """Queue one reconstruction for every combination of the values in ``vary``, either all or none of them.

        Parameters
        ----------
        vary
            Values of each parameter that varies; ``mask_id``: masks to look through, ``frame``: frames.
        each
            A job for each excitation wavelength of the scan, or each frame.
        priority
            Smaller ones run first.
        points
            Options for subset masks.
        requires
            What each job's worker must have: ``{"memory": bytes, "cores": threads}``, either or both.
        parameters
            What all have in common.
        """
        values = {name: list(several) for name, several in (vary or {}).items()}
        named = drop_none(each=each, priority=priority, points=points, requires=requires)
        body = {"scan_id": scan_id, "vary": values, "parameters": parameters, **named}
        return await self._session.request_model(Batch, routes.CREATE_BATCH, json=body, key=idempotency_key)

    @dual_method
    async def cancel(self, batch_id: str, reason: str | None = None) -> Batch:
        """Cancel all queued and running jobs of a batch."""
        body = {"state": "cancelled", "reason": reason}
        return await self._session.request_model(Batch, routes.WISH_BATCH, {"id": batch_id}, json=body)
