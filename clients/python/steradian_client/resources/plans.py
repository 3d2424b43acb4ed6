"""Plans: in what order and how fast."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from steradian_client import routes
from steradian_client.models import Design, Plan, Preview
from steradian_client.resources.base import Stored
from steradian_client.worlds import World, operation


class Plans(Stored[World, Plan]):
    """In what order and how fast; parameters as of ``steradian.ScanPlan``, such as pulse_rate (Hz) or samples."""

    _kind, _read, _list, _delete = Plan, routes.READ_PLAN, routes.LIST_PLANS, routes.DELETE_PLAN

    @operation
    async def create(self, /, mask_id: str, **parameters: Any) -> Plan:
        """Make a plan; the same parameters give the same plan."""
        return await self._session.ask(Plan, routes.CREATE_PLAN, json={"mask_id": mask_id, **parameters})

    @operation
    async def preview(self, /, mask_id: str, **parameters: Any) -> Preview:
        """Tell what a plan would cost, keeping nothing."""
        return await self._session.ask(Preview, routes.PREVIEW_PLAN, json={"mask_id": mask_id, **parameters})

    @operation
    async def design(
        self, /, arrangement: Mapping[str, Any], point: tuple[float, float, float] | None = None, **parameters: Any
    ) -> Design:
        """Tell what a mask of these parameters and its plan would be, seen from ``point`` (m), keeping nothing."""
        asked = {"arrangement": dict(arrangement), "point": point, **parameters}
        return await self._session.ask(Design, routes.PREVIEW_DESIGN, json=asked)
