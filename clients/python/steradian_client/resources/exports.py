"""Export of volumes and scans to file formats of other programs."""

from __future__ import annotations

import builtins
from pathlib import Path

from steradian_client import routes
from steradian_client.downloads import download
from steradian_client.models import Job
from steradian_client.polling import Report
from steradian_client.resources.base import AwaitableResource, drop_none
from steradian_client.sync_async import Mode, dual_method


class Exports(AwaitableResource[Mode, Job]):
    """Export of volumes and scans to file formats of other programs."""

    _kind, _read, _list, _delete, _event = Job, routes.READ_JOB, routes.LIST_JOBS, routes.DELETE_JOB, "job"

    @dual_method
    async def create(
        self,
        format: str,
        *,
        reconstruction_id: str | None = None,
        scan_id: str | None = None,
        index: int | None = None,
        idempotency_key: str | None = None,
    ) -> Job:
        """Queue an export: ipasc, sgl of a scan; hdf5, nifti, tiff, ome-zarr, vtkhdf, nrrd, png of a reconstruction.

        A series is exported whole (hdf5, nifti, tiff, ome-zarr), or its volume with an ``index``.
        """
        return await self._create(format, reconstruction_id, scan_id, index, idempotency_key)

    @dual_method
    async def export_and_download(
        self,
        format: str,
        folder: Path | str,
        *,
        reconstruction_id: str | None = None,
        scan_id: str | None = None,
        index: int | None = None,
        progress: Report | None = None,
        timeout: float | None = None,
    ) -> builtins.list[Path]:
        """Create an export, wait for its end, and download the files into a folder; errors as of :meth:`wait`."""
        place = Path(folder)
        await self._session.transport.call(lambda: place.mkdir(parents=True, exist_ok=True))
        job = await self._create(format, reconstruction_id, scan_id, index, None)
        job = await self._until_over(job, progress, timeout)
        return [  # in that folder, whatever the service calls them
            await download(self._session, routes.READ_JOB_FILE, {"id": job.id, "name": name}, place / Path(name).name)
            for name in job.files
        ]

    async def _create(
        self, format: str, reconstruction_id: str | None, scan_id: str | None, index: int | None, key: str | None
    ) -> Job:
        body = drop_none(
            kind="export", format=format, reconstruction_id=reconstruction_id, scan_id=scan_id, index=index
        )
        return await self._session.request_model(Job, routes.CREATE_JOB, json=body, key=key)
