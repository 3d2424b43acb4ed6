"""Collection of scan plans."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from steradian_client import routes
from steradian_client.models import Design, Plan, Preview
from steradian_client.resources.base import Stored
from steradian_client.worlds import World, operation


class Plans(Stored[World, Plan]):
    """Collection of scan plans; parameters as of ``steradian.ScanPlan``, such as pulse_rate (Hz) or samples."""

    _kind, _read, _list, _delete = Plan, routes.READ_PLAN, routes.LIST_PLANS, routes.DELETE_PLAN

    @operation
    async def create(self, /, mask_id: str, **parameters: Any) -> Plan:
        """Make a plan; the same parameters give the same plan."""
        return await self._session.ask(Plan, routes.CREATE_PLAN, json={"mask_id": mask_id, **parameters})

    @operation
    async def preview(self, /, mask_id: str, **parameters: Any) -> Preview:
        """Return a plan's cost without storing it."""
        return await self._session.ask(Preview, routes.PREVIEW_PLAN, json={"mask_id": mask_id, **parameters})

    @operation
    async def design(
        self, /, arrangement: Mapping[str, Any], point: tuple[float, float, float] | None = None, **parameters: Any
    ) -> Design:
        """Return the preview of a mask and its plan, seen from ``point`` (m), without storing them."""
        asked = {"arrangement": dict(arrangement), "point": point, **parameters}
        return await self._session.ask(Design, routes.PREVIEW_DESIGN, json=asked)
