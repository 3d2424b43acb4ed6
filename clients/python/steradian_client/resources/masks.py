"""Collection of masks (sets of detection points)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from steradian_client import routes
from steradian_client.downloads import download
from steradian_client.models import Mask, MaskPreview, Points, PointSpread, PulseBudget
from steradian_client.resources.base import CrudResource
from steradian_client.sync_async import Mode, dual_method


class Masks(CrudResource[Mode, Mask]):
    """Collection of masks (sets of detection points)."""

    _kind, _read, _list, _delete = Mask, routes.READ_MASK, routes.LIST_MASKS, routes.DELETE_MASK

    @dual_method
    async def create(self, /, arrangement: str, **parameters: Any) -> Mask:
        """Create a mask of any arrangement; the same parameters return the same mask."""
        return await self._create(arrangement, parameters)

    @dual_method
    async def preview(self, /, arrangement: str, **parameters: Any) -> MaskPreview:
        """Return a mask's metrics without storing it."""
        asked = {"arrangement": arrangement, **parameters}
        return await self._session.request_model(MaskPreview, routes.PREVIEW_MASK, json=asked)

    @dual_method
    async def point_spread(
        self, /, arrangement: str, point: tuple[float, float, float] | None = None, **parameters: Any
    ) -> PointSpread:
        """Return the simulated image of a tiny ball at ``point`` (m), measured with a mask that is not stored."""
        asked = {"arrangement": {"arrangement": arrangement, **parameters}, "point": point}
        return await self._session.request_model(PointSpread, routes.PREVIEW_POINT_SPREAD, json=asked)

    @dual_method
    async def budget(self, /, *, duration: float, depth: float, vessel: float, **parameters: Any) -> PulseBudget:
        """Return points × averages for a scan of ``duration`` (s) of a vessel of given depth and diameter (m).

        ``noise`` (dB, of one pulse) or ``scan_id`` is needed; other parameters as in the HTTP API.
        """
        asked = {"duration": duration, "depth": depth, "vessel": vessel, **parameters}
        return await self._session.request_model(PulseBudget, routes.PREVIEW_BUDGET, json=asked)

    @dual_method
    async def equi_steradian(self, *, aperture: float, depth: float, count: int) -> Mask:
        """Create a mask of equal solid angles; ``aperture`` and ``depth`` of the point of interest in metres."""
        return await self._create("equi-steradian", {"aperture": aperture, "depth": depth, "count": count})

    @dual_method
    async def grid(self, *, aperture: float, count: int, interval: float) -> Mask:
        """Create a mask with a grid of ``count`` × ``count`` points; ``aperture`` and ``interval`` in metres."""
        return await self._create("grid", {"aperture": aperture, "count": count, "interval": interval})

    @dual_method
    async def points(self, mask_id: str) -> Points:
        """Return positions and weights of a mask's points."""
        return await self._session.request_model(Points, routes.READ_POINTS, {"id": mask_id})

    @dual_method
    async def save_picture(self, mask_id: str, target: Path | str) -> Path:
        """Download a picture (PNG) of the mask: points, density and coverage."""
        return await download(self._session, routes.READ_PICTURE, {"id": mask_id}, target)

    async def _create(self, arrangement: str, parameters: dict[str, Any]) -> Mask:
        return await self._session.request_model(
            Mask, routes.CREATE_MASK, json={"arrangement": arrangement, **parameters}
        )
