"""Collection of scan plans."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from steradian_client import routes
from steradian_client.models import DesignPreview, Plan, Preview
from steradian_client.resources.base import CrudResource
from steradian_client.sync_async import Mode, dual_method


class Plans(CrudResource[Mode, Plan]):
    """Collection of scan plans; parameters as of ``steradian.ScanPlan``, such as pulse_rate (Hz) or samples."""

    _kind, _read, _list, _delete = Plan, routes.READ_PLAN, routes.LIST_PLANS, routes.DELETE_PLAN

    @dual_method
    async def create(self, /, mask_id: str, **parameters: Any) -> Plan:
        """Create a scan plan; the same parameters return the same plan."""
        return await self._session.request_model(Plan, routes.CREATE_PLAN, json={"mask_id": mask_id, **parameters})

    @dual_method
    async def preview(self, /, mask_id: str, **parameters: Any) -> Preview:
        """Return a plan's cost without storing it."""
        return await self._session.request_model(Preview, routes.PREVIEW_PLAN, json={"mask_id": mask_id, **parameters})

    @dual_method
    async def design(
        self, /, arrangement: Mapping[str, Any], point: tuple[float, float, float] | None = None, **parameters: Any
    ) -> DesignPreview:
        """Return the preview of a mask and its plan, seen from ``point`` (m), without storing them."""
        asked = {"arrangement": dict(arrangement), "point": point, **parameters}
        return await self._session.request_model(DesignPreview, routes.PREVIEW_DESIGN, json=asked)
