"""Collection of reconstructions: jobs that compute volumes from scans."""

from __future__ import annotations

import builtins
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from steradian_client import routes
from steradian_client.arrays import RAW, Volume, parse_array, slice_axes
from steradian_client.downloads import Report, download
from steradian_client.models import Job, Quality, Reconstruction, Revision
from steradian_client.resources.base import AwaitableResource, drop_none
from steradian_client.sync_async import Mode, dual_method


class Reconstructions(AwaitableResource[Mode, Reconstruction]):
    """Collection of reconstructions: jobs that compute volumes from scans.

    :attr:`Client.jobs` cancels them and has their attempts and log, by the same identifier.
    """

    _kind, _read, _list = Reconstruction, routes.READ_RECONSTRUCTION, routes.LIST_RECONSTRUCTIONS
    _delete = routes.DELETE_RECONSTRUCTION
    _event = "reconstruction"

    @dual_method
    async def create(
        self,
        /,
        scan_id: str,
        *,
        priority: int | None = None,
        follow: bool | None = None,
        interval: float | None = None,
        through: Mapping[str, Any] | None = None,
        frame: int | None = None,
        timeout: float | None = None,
        requires: Mapping[str, int] | None = None,
        idempotency_key: str | None = None,
        **parameters: Any,
    ) -> Reconstruction:
        """Queue a reconstruction of a scan.

        Parameters
        ----------
        priority
            Smaller ones run first.
        follow, interval
            Begin while the scan runs, with a revision every so many seconds.
        through
            ``{"mask_id": …}``: as if only the points of that mask had been measured.
        frame
            Which frame of a scan that has several.
        timeout
            Longest that it may run (s).
        requires
            What its worker must have: ``{"memory": bytes, "cores": threads}``, either or both.
        idempotency_key
            Repeating the call with the same key finds what the first call made; ``None`` makes a new key.
        parameters
            Such as modes, upsampling, method, sound_speed (m/s), tolerance; in place of sound_speed
            ``medium=[{"sound_speed": 1480, "thickness": 2e-3}, {"sound_speed": 1580}]``, layers from the film downwards
            in m/s and m, also with ``density`` (kg/m³) and ``attenuation``,
            ``{"coefficient": 0.75, "power": 1.5}`` in dB/(MHz^y cm).
        """
        named = drop_none(priority=priority, follow=follow, interval=interval, through=through, frame=frame)
        named = {**named, **drop_none(timeout=timeout, requires=requires)}
        body = {"scan_id": scan_id, "parameters": parameters, **named}
        return await self._session.request_model(
            Reconstruction, routes.CREATE_RECONSTRUCTION, json=body, key=idempotency_key
        )

    @dual_method
    async def prioritise(self, reconstruction_id: str, priority: int) -> Reconstruction:
        """Change the priority of a queued reconstruction; smaller values run first."""
        return await self._session.request_model(
            Reconstruction, routes.CHANGE_RECONSTRUCTION, {"id": reconstruction_id}, json={"priority": priority}
        )

    @dual_method
    async def revision(self, reconstruction_id: str) -> Revision:
        """Return points, coverage and quality of the newest intermediate image of a running scan."""
        return await self._session.request_model(Revision, routes.READ_REVISION, {"id": reconstruction_id})

    @dual_method
    async def volume(self, reconstruction_id: str, slice: str | None = None) -> Volume:
        """Return the volume with its axes; ``slice`` in NumPy's syntax, for example ``"10:20,::2,5"``."""
        report = (await self._session.request_model(Reconstruction, self._read, {"id": reconstruction_id})).report
        identifiers, params, headers = {"id": reconstruction_id}, {"slice": slice}, {"Accept": RAW}
        answer = await self._session.send_with_retries(routes.READ_VOLUME, identifiers, params=params, headers=headers)
        return Volume(parse_array(answer), *slice_axes(report or {}, slice))

    @dual_method
    async def download_volume(
        self, reconstruction_id: str, target: Path | str, *, progress: Report | None = None
    ) -> Path:
        """Download the volume as a NumPy file, float32 [x, y, z]."""
        identifiers, headers = {"id": reconstruction_id}, {"Accept": "application/x-npy"}
        return await download(
            self._session, routes.READ_VOLUME, identifiers, target, headers=headers, progress=progress
        )

    @dual_method
    async def download_mip(
        self, reconstruction_id: str, target: Path | str, *, axis: Literal["x", "y", "z", "depth"] = "z"
    ) -> Path:
        """Download a maximum-intensity projection (PNG); ``depth``: along z, coloured by depth."""
        return await download(self._session, routes.READ_MIP, {"id": reconstruction_id}, target, params={"axis": axis})

    @dual_method
    async def compare(
        self,
        reconstruction_id: str,
        reference_id: str,
        *,
        diameter: float | None = None,
        threshold: float | None = None,
        idempotency_key: str | None = None,
    ) -> Job:
        """Queue a quality comparison with another reconstruction, within a disc of ``diameter`` (m)."""
        body = drop_none(reference_id=reference_id, diameter=diameter, threshold=threshold)
        return await self._session.request_model(
            Job, routes.CREATE_QUALITY, {"id": reconstruction_id}, json=body, key=idempotency_key
        )

    @dual_method
    async def quality(self, reconstruction_id: str) -> builtins.list[Quality]:
        """Return the quality comparisons of the reconstruction, newest first."""
        return await self._session.list(Quality, routes.LIST_QUALITY, identifiers={"id": reconstruction_id})
