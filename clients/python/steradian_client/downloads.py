"""Resumable downloads with checksum verification, written by atomic writes."""

from __future__ import annotations

import base64
import hashlib
import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final

from steradian_client.errors import ConnectionFailed, CorruptTransfer, ServiceError
from steradian_client.request_session import INITIAL_BACKOFF, LONGEST_PAUSE, RETRYABLE, RequestSession
from steradian_client.routes import Route
from steradian_client.transport import StreamedResponse

Report = Callable[[int, int], None]
"""Called as ``progress(done, total)``, in bytes; ``total`` is 0 while unknown."""
_RANGE: Final = re.compile(r"bytes (\d+)-\d+/(\d+)")
_DIGEST: Final = re.compile(r"sha-256=:([A-Za-z0-9+/=]+):")


class Download:
    """State of one download into a file: received bytes, total bytes, ETag and checksum.

    Parameters
    ----------
    file
        Open for writing, empty.
    report
        Told of every piece.
    """

    def __init__(self, session: RequestSession, file: BinaryIO, report: Report | None) -> None:
        self._session, self._file, self._report = session, file, report
        self._etag: str | None = None
        self._digest, self._done, self._total = hashlib.sha256(), 0, 0
        self._stated: str | None = None
        """SHA-256 that the service states, base64."""

    async def fetch(
        self, route: Route, identifiers: Mapping[str, str], headers: Mapping[str, str], **more: Any
    ) -> None:
        """Download the file, resuming after interruptions, until it is complete.

        Raises
        ------
        ServiceError, Unreachable
            When the service refuses, or is away for longer than the session is patient.
        CorruptTransfer
            When it has come whole, but not as it was sent.
        """
        begun, pause = time.monotonic(), INITIAL_BACKOFF
        while True:
            before = self._done
            own = {"Accept-Encoding": "identity", "Want-Repr-Digest": "sha-256=1"} | self._range()
            try:
                async with self._session.open(route, identifiers, headers={**headers, **own}, **more) as incoming:
                    await self._take(incoming)
                if self._done >= self._total:
                    return self._check()
            except (ConnectionFailed, ServiceError) as error:
                passes = isinstance(error, ConnectionFailed) or error.status in RETRYABLE
                if isinstance(error, ServiceError) and error.status == 416:
                    await self._begin()
                elif not passes or not self._session.has_answered:
                    raise
                elif time.monotonic() - begun > self._session.patience:
                    raise
            if self._done > before:
                begun, pause = time.monotonic(), INITIAL_BACKOFF
            await self._session.transport.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE)

    def _range(self) -> dict[str, str]:
        """Return the range headers that request the remaining bytes of a partial file, if its version is unchanged."""
        if not self._done or self._etag is None or self._etag.startswith("W/"):
            return {}
        return {"Range": f"bytes={self._done}-", "If-Range": self._etag}

    async def _take(self, incoming: StreamedResponse) -> None:
        headers, part = incoming.response.headers, None
        if incoming.response.status_code == 206:
            part = _RANGE.fullmatch(headers.get("Content-Range", ""))
            if part is None or int(part[1]) != self._done:
                raise CorruptTransfer(
                    f"bytes from {self._done} on were requested, received {headers.get('Content-Range')}"
                )
            self._total = int(part[2])
        else:
            await self._begin()
            self._total = int(headers.get("Content-Length", 0))
        self._etag = headers.get("ETag")
        stated = _DIGEST.search(headers.get("Repr-Digest", ""))
        self._stated = stated[1] if stated else self._stated
        async for piece in incoming.pieces:
            await self._session.transport.call(lambda piece=piece: self._file.write(piece))  # type: ignore[misc]
            self._digest.update(piece)
            self._done += len(piece)
            if self._report is not None:
                self._report(self._done, self._total)

    async def _begin(self) -> None:
        def empty() -> None:
            self._file.seek(0)
            self._file.truncate()

        await self._session.transport.call(empty)
        self._digest, self._done, self._total, self._stated = hashlib.sha256(), 0, 0, None

    def _check(self) -> None:
        if self._total and self._done != self._total:
            raise CorruptTransfer(f"{self._done} bytes came instead of {self._total}")
        came = base64.b64encode(self._digest.digest()).decode()
        if self._stated is not None and came != self._stated:
            raise CorruptTransfer(f"the {self._done} bytes that came have the SHA-256 {came}, not {self._stated}")


async def download(
    session: RequestSession,
    route: Route,
    identifiers: Mapping[str, str],
    target: Path | str,
    *,
    params: Mapping[str, Any] | None = None,
    headers: Mapping[str, str] | None = None,
    progress: Report | None = None,
) -> Path:
    """Download a response body into ``target``, which appears only when the download is complete.

    Raises
    ------
    ServiceError, Unreachable, Damaged
        As of :meth:`Download.fetch`.
    """
    target = Path(target)
    draft = target.with_name(target.name + ".part")
    try:
        with await session.transport.call(lambda: draft.open("wb")) as file:
            await Download(session, file, progress).fetch(route, identifiers, headers or {}, params=params or {})
        return draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)
