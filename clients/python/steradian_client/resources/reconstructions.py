"""Reconstructions: jobs that turn scans into volumes."""

from __future__ import annotations

import builtins
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from steradian_client import routes
from steradian_client.arrays import RAW, Volume, array_of, axes_of
from steradian_client.downloads import Report, download
from steradian_client.models import Attempt, Job, Quality, Reconstruction, Revision
from steradian_client.resources.base import Working, given
from steradian_client.worlds import World, operation


class Reconstructions(Working[World, Reconstruction]):
    """Jobs that turn scans into volumes."""

    _kind, _read, _list = Reconstruction, routes.READ_RECONSTRUCTION, routes.LIST_RECONSTRUCTIONS
    _delete = routes.DELETE_RECONSTRUCTION
    _event = "reconstruction"

    @operation
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
        """Queue a reconstruction.

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
            Such as modes, upsampling, method, sound_speed (m/s), tolerance.
        """
        named = given(priority=priority, follow=follow, interval=interval, through=through, frame=frame)
        named = {**named, **given(timeout=timeout, requires=requires)}
        body = {"scan_id": scan_id, "parameters": parameters, **named}
        return await self._session.ask(Reconstruction, routes.CREATE_RECONSTRUCTION, json=body, key=idempotency_key)

    @operation
    async def prioritise(self, reconstruction_id: str, priority: int) -> Reconstruction:
        """Move one that waits; smaller ones run first."""
        return await self._session.ask(
            Reconstruction, routes.CHANGE_RECONSTRUCTION, {"id": reconstruction_id}, json={"priority": priority}
        )

    @operation
    async def cancel(self, reconstruction_id: str, reason: str | None = None) -> Reconstruction:
        """Cancel one that waits or runs."""
        body = {"state": "cancelled", "reason": reason}
        return await self._session.ask(Reconstruction, routes.WISH_RECONSTRUCTION, {"id": reconstruction_id}, json=body)

    @operation
    async def attempts(self, reconstruction_id: str) -> builtins.list[Attempt]:
        """Read every start of it with its end."""
        identifiers = {"id": reconstruction_id}
        return await self._session.list(Attempt, routes.READ_RECONSTRUCTION_ATTEMPTS, identifiers=identifiers)

    @operation
    async def log(self, reconstruction_id: str) -> str:
        """Return the log of the reconstruction."""
        return (await self._session.exchange(routes.READ_RECONSTRUCTION_LOG, {"id": reconstruction_id})).text

    @operation
    async def revision(self, reconstruction_id: str) -> Revision:
        """Read how good the newest image of a scan is that is being followed."""
        return await self._session.ask(Revision, routes.READ_REVISION, {"id": reconstruction_id})

    @operation
    async def volume(self, reconstruction_id: str, slice: str | None = None) -> Volume:
        """Read the volume with its axes; ``slice`` in numpy's syntax, such as ``"10:20,::2,5"``."""
        report = (await self._session.ask(Reconstruction, self._read, {"id": reconstruction_id})).report
        identifiers, params, headers = {"id": reconstruction_id}, {"slice": slice}, {"Accept": RAW}
        answer = await self._session.exchange(routes.READ_VOLUME, identifiers, params=params, headers=headers)
        return Volume(array_of(answer), *axes_of(report or {}, slice))

    @operation
    async def save_volume(self, reconstruction_id: str, target: Path | str, *, progress: Report | None = None) -> Path:
        """Download the volume as a NumPy file, float32 [x, y, z]."""
        identifiers, headers = {"id": reconstruction_id}, {"Accept": "application/x-npy"}
        return await download(
            self._session, routes.READ_VOLUME, identifiers, target, headers=headers, progress=progress
        )

    @operation
    async def save_mip(
        self, reconstruction_id: str, target: Path | str, *, axis: Literal["x", "y", "z", "depth"] = "z"
    ) -> Path:
        """Download a maximum-intensity projection (PNG); ``depth``: along z, coloured by depth."""
        return await download(self._session, routes.READ_MIP, {"id": reconstruction_id}, target, params={"axis": axis})

    @operation
    async def compare(
        self,
        reconstruction_id: str,
        reference_id: str,
        *,
        diameter: float | None = None,
        threshold: float | None = None,
        idempotency_key: str | None = None,
    ) -> Job:
        """Queue a comparison with another reconstruction, within a disc of ``diameter`` (m)."""
        body = given(reference_id=reference_id, diameter=diameter, threshold=threshold)
        return await self._session.ask(
            Job, routes.CREATE_QUALITY, {"id": reconstruction_id}, json=body, key=idempotency_key
        )

    @operation
    async def quality(self, reconstruction_id: str) -> builtins.list[Quality]:
        """Return the quality comparisons of the reconstruction, newest first."""
        return await self._session.list(Quality, routes.LIST_QUALITY, identifiers={"id": reconstruction_id})
