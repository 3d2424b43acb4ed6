"""Collections for data exchange: uploads and imports."""

from __future__ import annotations

import base64
import re
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from steradian_client import routes
from steradian_client.downloads import Report as BytesReport
from steradian_client.errors import Conflict, ConnectionFailed, CorruptTransfer, InvalidInput, NotFound, ServiceError
from steradian_client.models import Job, Scan, Upload, UploadPreview
from steradian_client.polling import Report
from steradian_client.request_session import INITIAL_BACKOFF, LONGEST_PAUSE, RETRYABLE, RequestSession
from steradian_client.resources.base import AwaitableResource, drop_none, id_of
from steradian_client.sync_async import Mode, Resource, dual_method
from steradian_client.transport import UploadFile

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


RESUMED_FROM: Final = 2**20
"""Bytes from which on a file is sent so that it can be gone on with where it broke off."""
TUS: Final = {"Tus-Resumable": "1.0.0"}


class Uploads(Resource[Mode]):
    """Collection of uploaded files that wait for an import."""

    @dual_method
    async def create(self, file: Path | str, *, progress: BytesReport | None = None) -> Upload:
        """Upload a file in parts, resuming after interruptions; the service stores it for a day.

        Raises
        ------
        CorruptTransfer
            When the service received other bytes.
        """
        return await _upload(self._session, Path(file), progress)

    @dual_method
    async def get(self, upload_id: str) -> Upload:
        """Return the metadata of an upload."""
        return await self._session.request_model(Upload, routes.READ_UPLOAD, {"id": upload_id})

    @dual_method
    async def preview(
        self,
        upload: Upload | str,
        *,
        description: Mapping[str, Any] | None = None,
        companion: Upload | str | None = None,
    ) -> UploadPreview:
        """Preview an import of an upload, with its missing fields; ``companion`` has the positions."""
        body = drop_none(description=description, companion_id=None if companion is None else id_of(companion))
        return await self._session.request_model(UploadPreview, routes.PREVIEW_UPLOAD, {"id": id_of(upload)}, json=body)

    @dual_method
    async def delete(self, upload: Upload | str) -> None:
        """Delete an uploaded file."""
        await self._session.send_with_retries(routes.DELETE_UPLOAD, {"id": id_of(upload)})


class Imports(AwaitableResource[Mode, Job]):
    """Import of recordings from other systems as scans."""

    _kind, _read, _list, _delete, _event = Job, routes.READ_JOB, routes.LIST_JOBS, routes.DELETE_JOB, "job"

    @dual_method
    async def create(
        self,
        upload: Upload | str,
        *,
        description: Mapping[str, Any] | None = None,
        companion: Upload | str | None = None,
        labels: Mapping[str, str] | None = None,
        idempotency_key: str | None = None,
    ) -> Job:
        """Queue the import of an upload as a scan.

        Parameters
        ----------
        description
            Values that are not in the file: sampling_interval, positions, sound_speed, …
        companion
            An upload with the positions (csv, npy), or k-Wave's input file.
        labels
            Of the scan.
        """
        other = None if companion is None else id_of(companion)
        return await self._create(id_of(upload), description, other, labels, idempotency_key)

    @dual_method
    async def import_file(
        self,
        file: Path | str,
        *,
        description: Mapping[str, Any] | None = None,
        companion: Path | str | None = None,
        labels: Mapping[str, str] | None = None,
        progress: Report | None = None,
        timeout: float | None = None,
    ) -> Scan:
        """Upload a file, import it and wait for the scan; errors as of :meth:`wait`."""
        return await self._run(Path(file), description, companion, labels, progress, timeout)

    @dual_method
    async def import_arrays(
        self,
        /,
        traces: ArrayLike,
        positions: ArrayLike,
        *,
        sampling_interval: float,
        sound_speed: float,
        labels: Mapping[str, str] | None = None,
        progress: Report | None = None,
        timeout: float | None = None,
        **description: Any,
    ) -> Scan:
        """Import NumPy arrays as a scan, and wait for the scan; errors as of :meth:`wait`.

        Parameters
        ----------
        traces
            (M, N_t) A-lines.
        positions
            (M, 2) places of the sensors in metres, (M, 1) for a line.
        sampling_interval, sound_speed
            In s and m/s.
        description
            What else there is to say, such as time_zero (s), aperture (m) or weights (m²).
        """
        import numpy as np

        with tempfile.TemporaryDirectory(prefix="steradian-") as folder:
            file, about = Path(folder) / "arrays.npz", {"sampling_interval": sampling_interval, "c": sound_speed}
            data = {"traces": np.asarray(traces), "positions": np.asarray(positions, float), **about}
            await self._session.transport.call(lambda: np.savez(file, **data))  # type: ignore[arg-type]
            return await self._run(file, description or None, None, labels, progress, timeout)

    async def _run(
        self,
        file: Path,
        description: Mapping[str, Any] | None,
        companion: Path | str | None,
        labels: Mapping[str, str] | None,
        progress: Report | None,
        timeout: float | None,
    ) -> Scan:
        def sent(done: int, total: int) -> None:
            if progress is not None:
                progress("bytes", done, total)

        if file.suffix.lower() == ".sgl":
            description = {"file_name": file.name[:300], **(description or {})}  # its name says more than the file
        upload = await _upload(self._session, file, sent)
        other = None if companion is None else (await _upload(self._session, Path(companion), sent)).id
        job = await self._create(upload.id, description, other, labels, None)
        done = await self._until_over(job, progress, timeout)
        return await self._session.request_model(Scan, routes.READ_SCAN, {"id": str((done.result or {})["scan_id"])})

    async def _create(
        self,
        upload_id: str,
        description: Mapping[str, Any] | None,
        companion_id: str | None,
        labels: Mapping[str, str] | None,
        key: str | None,
    ) -> Job:
        body = drop_none(
            kind="import", upload_id=upload_id, description=description, companion_id=companion_id, labels=labels
        )
        return await self._session.request_model(Job, routes.CREATE_JOB, json=body, key=key)


async def _upload(session: RequestSession, file: Path, progress: BytesReport | None) -> Upload:
    sending = await session.transport.call(lambda: UploadFile(file, progress))
    if sending.size >= RESUMED_FROM and (begun := await _begin(session, sending.size)) is not None:
        with suppress(NotFound):  # it has been deleted meanwhile, or another node has it: all is sent anew
            try:
                return await _send_pieces(session, sending, begun)
            except NotFound:
                raise
            except (ServiceError, CorruptTransfer):
                with suppress(
                    ServiceError, ConnectionFailed
                ):  # what came of it takes room, and cannot be named any more
                    await session.send_with_retries(routes.DELETE_UPLOAD, {"id": begun})
                raise
        sending.start = 0
    headers = {"Content-Type": "application/octet-stream"}
    answer = await session.send_with_retries(routes.CREATE_UPLOAD, file=sending, headers=headers)
    upload = Upload.model_validate_json(answer.content)
    _check(sending, upload.bytes, upload.sha256 or "")
    return upload


async def _begin(session: RequestSession, size: int) -> str | None:
    """Create a resumable upload and return its identifier; ``None`` if the service supports whole bodies only."""
    try:
        answer = await session.send_with_retries(routes.CREATE_UPLOAD, headers={"Upload-Length": str(size), **TUS})
    except InvalidInput as error:
        if any("body" in str(one.get("pointer")) for one in error.errors):
            return None
        raise
    return Upload.model_validate_json(answer.content).id


async def _send_pieces(session: RequestSession, sending: UploadFile, identifier: str) -> Upload:
    """Send a file in parts, resuming after interruptions as long as bytes arrive."""
    where, begun, pause = {"id": identifier}, time.monotonic(), INITIAL_BACKOFF
    received = None  # its checksum, unless the last answer is lost
    while True:
        headers = {"Content-Type": "application/offset+octet-stream", "Upload-Offset": str(sending.start), **TUS}
        try:
            answer = await session.send_with_retries(routes.APPEND_UPLOAD, where, file=sending, headers=headers)
            received = _sha256(answer.headers.get("Repr-Digest", ""))
            _check(sending, int(answer.headers["Upload-Offset"]), received)
        except (ConnectionFailed, ServiceError) as error:
            passes = isinstance(error, ConnectionFailed | Conflict) or error.status in RETRYABLE
            if not passes or time.monotonic() - begun > session.patience:
                raise
            await session.transport.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE)
        upload = await session.request_model(Upload, routes.READ_UPLOAD, where)
        if upload.length is None:
            return upload.model_copy(update={"sha256": received})
        if upload.bytes > sending.start:
            sending.start, begun, pause = upload.bytes, time.monotonic(), INITIAL_BACKOFF


def _check(sending: UploadFile, size: int, sha256: str) -> None:
    if (size, sha256) != (sending.size, sending.sha256):
        was = f"{sending.path.name} has {sending.size} bytes, SHA-256 {sending.sha256}"
        raise CorruptTransfer(f"{was}; {size} bytes with SHA-256 {sha256 or 'unknown'} were received")


def _sha256(digest: str) -> str:
    """Return the checksum from the header ``Repr-Digest``; empty if the header is missing."""
    found = re.search(r"sha-256=:([A-Za-z0-9+/=]+):", digest)
    return base64.b64decode(found[1]).hex() if found else ""
