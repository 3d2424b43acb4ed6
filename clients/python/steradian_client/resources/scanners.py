"""Collection of scanners: state, lease, emergency stop and faults."""

from __future__ import annotations

import builtins
from collections.abc import AsyncIterator
from typing import Final

from steradian_client import routes
from steradian_client.errors import ClientError
from steradian_client.models import EmergencyStop, Lease, Scanner
from steradian_client.sync_async import Mode, Resource, dual_context_manager, dual_method

SCANNER: Final = "scanner-0"
"""The scanner of a service that has one."""


class Scanners(Resource[Mode]):
    """Collection of scanners: state, lease, emergency stop and faults."""

    @dual_method
    async def list(self) -> builtins.list[Scanner]:
        """Return all scanners."""
        return await self._session.list(Scanner, routes.LIST_SCANNERS)

    @dual_method
    async def get(self, scanner_id: str = SCANNER) -> Scanner:
        """Return the state of a scanner."""
        return await self._session.request_model(Scanner, routes.READ_SCANNER, {"id": scanner_id})

    @dual_method
    async def take_lease(
        self,
        holder: str,
        *,
        seconds: float = 600.0,
        note: str | None = None,
        lease: Lease | int | None = None,
        scanner_id: str = SCANNER,
    ) -> Lease:
        """Acquire the lease of a scanner for ``seconds`` from now, or extend the caller's ``lease``.

        Raises
        ------
        Conflict
            When somebody else holds the scanner.
        """
        return await self._take(holder, seconds, note, lease, scanner_id)

    @dual_method
    async def return_lease(self, lease: Lease | int, *, scanner_id: str = SCANNER) -> None:
        """Release the lease of a scanner; no effect without a lease."""
        await self._session.send_with_retries(routes.RETURN_LEASE, {"id": scanner_id}, headers=lease_header(lease))

    @dual_context_manager
    async def lease(
        self, holder: str, *, seconds: float = 600.0, note: str | None = None, scanner_id: str = SCANNER
    ) -> AsyncIterator[Lease]:
        """Context manager that holds the lease of a scanner for at most ``seconds``.

        Raises the errors of :meth:`take_lease`.
        """
        lease = await self._take(holder, seconds, note, None, scanner_id)
        try:
            yield lease
        finally:
            await self._session.send_with_retries(routes.RETURN_LEASE, {"id": scanner_id}, headers=lease_header(lease))

    @dual_method
    async def emergency_stop(self, reason: str | None = None, *, scanner_id: str = SCANNER) -> EmergencyStop:
        """Switch the laser off and abort running and queued scans; check ``laser`` of the result."""
        body = {"reason": reason} if reason else None
        answer = await self._session.send_with_retries(routes.PRESS_STOP, {"id": scanner_id}, json=body)
        return EmergencyStop.model_validate(answer.json()["emergency_stop"])

    @dual_method
    async def stop_all(self, reason: str | None = None) -> dict[str, EmergencyStop]:
        """Trigger the emergency stop of every scanner; returns the results by name, empty without scanners."""
        answer = await self._session.send_with_retries(routes.STOP_ALL, json={"reason": reason} if reason else None)
        return {one["id"]: EmergencyStop.model_validate(one["emergency_stop"]) for one in answer.json()["items"]}

    @dual_method
    async def retire(self, scanner_id: str, *, abandon: bool = False, reason: str | None = None) -> None:
        """Decommission a scanner that no longer exists; its node registers it again when it starts.

        Parameters
        ----------
        abandon
            Whether its scans that are not over are given up: what is stored of them is kept.

        Raises
        ------
        Conflict
            When its node lives, or a scan of it is not over.
        """
        about: dict[str, bool | str] = {"reason": reason} if reason else {}
        if abandon:
            about["abandon"] = True
        await self._session.send_with_retries(routes.RETIRE_SCANNER, {"id": scanner_id}, params=about)

    @dual_method
    async def release_emergency_stop(
        self, stop: EmergencyStop | str | None = None, reason: str | None = None, *, scanner_id: str = SCANNER
    ) -> Scanner:
        """Release the emergency stop; with ``stop``, the service rejects the request if there is a newer stop."""
        number = stop.number if isinstance(stop, EmergencyStop) else stop
        # A named stop can be released twice without harm; another one, pressed meanwhile, must not be.
        route = routes.RELEASE_STOP if number is None else routes.RELEASE_NAMED_STOP
        return await self._session.request_model(
            Scanner, route, {"id": scanner_id}, params={"number": number, "reason": reason}
        )

    @dual_method
    async def clear_fault(self, scanner_id: str = SCANNER, *, reason: str | None = None) -> Scanner:
        """Clear a latched fault, once its cause is removed.

        The laser stays off, and an interrupted scan can be resumed.

        Nothing happens where no fault is latched.

        Raises
        ------
        Conflict
            While the cause stands (``fault-stands``), or a scan or another program has the scanner.
        """
        body = {"reason": reason} if reason else None
        return await self._session.request_model(Scanner, routes.CLEAR_FAULT, {"id": scanner_id}, json=body)

    async def _take(
        self, holder: str, seconds: float, note: str | None, lease: Lease | int | None, scanner_id: str
    ) -> Lease:
        body = {"holder": holder, "seconds": seconds, "note": note}
        scanner = await self._session.request_model(
            Scanner, routes.TAKE_LEASE, {"id": scanner_id}, json=body, headers=lease_header(lease)
        )
        if scanner.lease is None:
            raise ClientError(f"the lease of {scanner_id} ended before its answer came")
        return scanner.lease


def lease_header(lease: Lease | int | None) -> dict[str, str]:
    """Return the request header with the fencing token of a lease."""
    if lease is None:
        return {}
    return {"Scanner-Lease": str(lease.fence if isinstance(lease, Lease) else lease)}
