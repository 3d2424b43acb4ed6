"""Collection of reconstructions: jobs that compute volumes from scans."""

from __future__ import annotations

import builtins
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from steradian_client import routes
from steradian_client.arrays import RAW, Volume, parse_array, slice_axes
from steradian_client.downloads import Report, download
from steradian_client.models import Job, Measurement, Quality, Reconstruction, Revision
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
        wavelength: float | None = None,
        average: bool | None = None,
        align: bool | None = None,
        motion: bool | None = None,
        timeout: float | None = None,
        requires: Mapping[str, int] | None = None,
        idempotency_key: str | None = None,
        **parameters: Any,
    ) -> Reconstruction:
        """Queue a reconstruction of a scan; a scan of several frames becomes a series of volumes.

        Parameters
        ----------
        priority
            Smaller ones run first.
        follow, interval
            Begin while the scan runs, with a revision every so many seconds.
        through
            ``{"mask_id": …}``: as if only the points of that mask had been measured.
        frame
            One frame of a scan that has several, for a single volume.
        wavelength
            Excitation wavelength (m) that the series is limited to.
        average
            The mean of the frames at each wavelength, instead of each frame.
        align, motion
            Undo shifts of the object between the volumes of a series, and motion within each frame.
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
        selected = drop_none(wavelength=wavelength, average=average, align=align, motion=motion)
        named = {**named, **selected, **drop_none(timeout=timeout, requires=requires)}
        body = {"scan_id": scan_id, "parameters": parameters, **named}
        return await self._session.request_model(
            Reconstruction, routes.CREATE_RECONSTRUCTION, json=body, key=idempotency_key
        )

    @dual_method
    async def unmix(
        self, /, series_id: str, *, priority: int | None = None, idempotency_key: str | None = None, **options: Any
    ) -> Reconstruction:
        """Queue the unmixing of a series: maps of oxygen saturation and chromophores, with an index each.

        Parameters
        ----------
        series_id
            Identifier of a series of at least as many wavelengths as chromophores.
        priority, idempotency_key
            As of :meth:`create`.
        options
            Such as ``chromophores=["oxyhaemoglobin", "deoxyhaemoglobin", "water"]``, ``fluence={"model": "fit"}``,
            ``wavelengths`` (m), ``significance``.
        """
        series = await self._session.request_model(Reconstruction, self._read, {"id": series_id})
        body = {"scan_id": series.scan_id, "reconstruction_id": series_id, "unmixing": options}
        body |= drop_none(priority=priority)
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
    async def volume(self, reconstruction_id: str, slice: str | None = None, *, index: int | None = None) -> Volume:
        """Return the volume with its axes; ``slice`` in NumPy's syntax, for example ``"10:20,::2,5"``.

        Of a series ``index`` says which volume, by its place in ``report["frames"]``.
        """
        report = (await self._session.request_model(Reconstruction, self._read, {"id": reconstruction_id})).report
        identifiers, params, headers = {"id": reconstruction_id}, {"slice": slice, "index": index}, {"Accept": RAW}
        answer = await self._session.send_with_retries(routes.READ_VOLUME, identifiers, params=params, headers=headers)
        return Volume(parse_array(answer), *slice_axes(report or {}, slice))

    @dual_method
    async def download_volume(
        self,
        reconstruction_id: str,
        target: Path | str,
        *,
        index: int | None = None,
        progress: Report | None = None,
    ) -> Path:
        """Download the volume, or that of a series with an index, as a NumPy file, float32 [x, y, z]."""
        about: dict[str, Any] = {"headers": {"Accept": "application/x-npy"}, "params": drop_none(index=index)}
        identifiers = {"id": reconstruction_id}
        return await download(self._session, routes.READ_VOLUME, identifiers, target, progress=progress, **about)

    @dual_method
    async def download_mip(
        self, reconstruction_id: str, target: Path | str, *, axis: Literal["x", "y", "z", "depth"] = "z"
    ) -> Path:
        """Download a maximum-intensity projection (PNG); ``depth``: along z, coloured by depth.

        That of a series shows all its volumes, that of an unmixing oxygen saturation; both along z only.
        """
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

    @dual_method
    async def measurements(
        self, reconstruction_id: str, *, also: builtins.list[str] | None = None
    ) -> builtins.list[Measurement]:
        """Return the named measurements of the volume with their values, then those of the reconstructions ``also``."""
        return await self._session.list(
            Measurement, routes.READ_MEASUREMENTS, filters={"also": also or []}, identifiers={"id": reconstruction_id}
        )

    @dual_method
    async def set_measurements(
        self, reconstruction_id: str, measurements: builtins.list[Mapping[str, Any]]
    ) -> builtins.list[Measurement]:
        """Replace the named measurements of the volume and return their values, in metres.

        Parameters
        ----------
        measurements
            Each with ``kind`` (profile, region, contrast, point), ``name``, ``axis``, ``slab``, ``start`` and ``end``.
        """
        body = {"items": [dict(each) for each in measurements]}
        answer = await self._session.send_with_retries(routes.SET_MEASUREMENTS, {"id": reconstruction_id}, json=body)
        return [Measurement.model_validate(each) for each in answer.json()["items"]]
